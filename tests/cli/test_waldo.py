"""An arm has one master: lerobot-teleoperate, or yam-waldo. Whoever comes second is told who drives it."""

import contextlib
import re
import socket

import pytest

from lerobot_robot_yam.waldo.wire import ask_once
from tests.cli.conftest import commands_on, options, virtual

pytestmark = [pytest.mark.long, pytest.mark.alone]

FOLLOWER, LEADER, HOST = "follower_left", "leader_left", "127.0.0.1"
ARMS = options(robot=virtual("follower", FOLLOWER), teleop=virtual("leader", LEADER))
TELEOPERATE = ["lerobot-teleoperate", *ARMS]


commands = commands_on(FOLLOWER, LEADER)


@contextlib.contextmanager
def serving(commands):
    """`yam-waldo` for the follower, which is not armed: its port and process. It lands in the end."""
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        port = taken.getsockname()[1]
    options = ["--hardware", "--channel", FOLLOWER, "--rig", commands.rig.name, "--no-page", "--port", str(port)]
    process = commands.start("yam-waldo", *options)
    commands.wait(lambda: ask_once(HOST, port, "ping"), process, 60.0)
    yield str(port), process
    process.terminate()
    assert commands.finish(process) == 0


def refused(commands, program, pid):
    """Whether the last command was told that process `pid` of this program drives the follower."""
    words = rf"{FOLLOWER}.* in use by process \d+, which drives it for .*{program}.*, process {pid}\b"
    return re.search(words, commands.output())


def test_a_follower_that_is_teleoperated_cannot_be_armed(commands):
    with serving(commands) as (port, _):
        teleoperation = commands.start(*TELEOPERATE, "--teleop_time_s=120")
        commands.wait_enabled(teleoperation, FOLLOWER, LEADER)
        commands.wait_connected(teleoperation)
        assert commands.run("yam-waldo", "arm", "--port", port, "--yes") == 1
        assert refused(commands, "lerobot-teleoperate", teleoperation.pid), commands.output()[-4000:]
        assert teleoperation.poll() is None and commands.enabled() == [FOLLOWER, LEADER]  # it has noticed nothing
        teleoperation.terminate()
        commands.finish(teleoperation)
    commands.assert_landed()


def test_an_armed_follower_cannot_be_teleoperated(commands):
    with serving(commands) as (port, controller):
        assert commands.run("yam-waldo", "arm", "--port", port, "--yes") == 0, commands.output()[-4000:]
        assert commands.run(*TELEOPERATE, "--teleop_time_s=5") != 0
        assert refused(commands, "yam-waldo", controller.pid), commands.output()[-4000:]
        assert commands.enabled() == [FOLLOWER]  # it is held on, and no leader was left energised
    commands.assert_landed()
