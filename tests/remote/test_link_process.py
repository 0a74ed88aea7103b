"""The process between a program and a host: it has the host land the arms when the program ends, at any moment."""

import os
import signal
import subprocess
import sys
import time

import pytest

from lerobot_robot_yam.remote.hosted_group import Phase
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.hosted import ServedArms
from tests.support.paths import ROOT

ARM = "follower_left"
PROGRAM = """
import sys
from lerobot_robot_yam.remote.host_address import HostAddress
from tests.support.hosted import ServedArms
ServedArms.session_at(HostAddress.of(sys.argv[1]), ("",)).start()
"""


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_program_that_ends_while_the_host_energises_has_the_arm_landed_at_once(number):
    """The search of the gripper's stops, which takes seconds, is cut short: the group never runs."""
    with running_rig(arms=[ARM]) as rig, ServedArms(rig, ARM, gripper_stops_rad=None) as served:
        (group,), seen = served.groups, []

        def wait(condition):
            deadline = time.monotonic() + 30.0
            while not condition():
                assert time.monotonic() < deadline
                if seen[-1:] != [group.phase]:
                    seen.append(group.phase)
                time.sleep(0.002)

        def motors(which):
            return which(motor["enabled"] for motor in rig.state()["arms"][ARM]["motors"].values())

        program = subprocess.Popen([sys.executable, "-c", PROGRAM, str(served.address)], cwd=ROOT)
        wait(lambda: motors(all))
        os.kill(program.pid, number)
        wait(lambda: program.poll() is not None)
        assert program.returncode != 0
        wait(lambda: group.phase is Phase.FREE)
        wait(lambda: not list(runtime_dir().glob("*remote*")))
        assert not motors(any)
        assert seen == [Phase.FREE, Phase.STARTING, Phase.LANDING, Phase.FREE]
