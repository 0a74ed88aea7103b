"""LeRobot's own commands, run as a user runs them, against a named rig that the test watches."""

import contextlib
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lerobot_robot_yam.rig.control import running_rig
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.paths import ROOT
from tests.support.terminal import Terminal
from tests.support.waiting import wait

CHANNELS = ("follower_left", "follower_right", "leader_left", "leader_right")


# Two processors carry four arms, their rig, three cameras and an encoder at full rate if nobody else needs them.
# What is asserted about rates is asserted of the shipped configs as they are, in the long tier.
CALM = [f"--{device}.{side}_arm_config.rate_hz=100" for device in ("robot", "teleop") for side in ("left", "right")]


def options(**sections):
    """The words of a command for options by section: `robot={"id": "lab"}` is --robot.id=lab."""
    return [f"--{section}.{name}={value}" for section, fields in sections.items() for name, value in fields.items()]


def virtual(role, channel, **fields):
    """Options of a device of one arm on the rig, such as a follower, whose weight the model tells."""
    given = {"type": f"yam_{role}", "interface": "yam_sim", "channel": channel, "id": "sim"}
    return given | {"gravity_factor": "[1,1,1,1,1,1]"} | fields


def one_episode(name, root, seconds, **fields):
    """Options of a data set of a single episode, local/NAME."""
    given = {"repo_id": f"local/{name}", "root": root, "single_task": "none", "fps": 30, "num_episodes": 1}
    given |= {"episode_time_s": seconds, "reset_time_s": 0, "push_to_hub": "false", "no_stamp": "true"}
    return given | fields


def commands_on(*channels, driven=None, **scene):
    """A fixture: commands on a rig with these arms, of which they drive some, by default all."""

    @pytest.fixture
    def commands(tmp_path):
        with running_rig(arms=list(channels), **scene) as rig:
            with contextlib.closing(Commands(rig, tmp_path, driven or channels)) as commands:
                yield commands

    return commands


class Commands:
    """Runs commands against one rig, which tells what they really did; None: each starts its own.

    `channels`: of the rig's arms.
    """

    def __init__(self, rig, directory, channels=CHANNELS):
        self.rig = rig
        self.directory = directory
        self.channels = channels
        self._started = []
        self._said_before = 0  # characters of output when the last command was started

    def start(self, name, *arguments, stdin=subprocess.DEVNULL, cwd=ROOT):
        """Start an installed command, such as lerobot-record, or Python's own options (name "-c", "-m")."""
        program = [sys.executable, name] if name.startswith("-") else [str(Path(sys.executable).parent / name)]
        environment = self.environment()
        self._said_before = len(self.output())
        with open(self.directory / "output.txt", "ab") as output:
            process = subprocess.Popen(
                [*program, *arguments],
                cwd=cwd,
                env=environment,
                stdin=stdin,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._started.append(process)
        return process

    def environment(self):
        """The environment of a command."""
        environment = os.environ | {"HF_LEROBOT_CALIBRATION": str(self.directory / "cal")}
        # For plugins that live with the tests: unlike `python -m`, an installed command does not look where it is.
        environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        return environment if self.rig is None else environment | {"YAM_RIG": self.rig.name}

    def in_terminal(self, name, *arguments):
        """Start an installed command in a terminal of its own."""
        program = Path(sys.executable).with_name(name)
        return Terminal(self.directory, program, *arguments, cwd=ROOT, env=self.environment())

    def close(self):
        """Kill what a failed test has left running: the next one would have its arms beside it."""
        for process in self._started:
            if process.poll() is None:
                process.kill()
                process.wait()

    def run(self, name, *arguments, timeout_s=150.0):
        """Run a command to its end; returns its exit status."""
        return self.finish(self.start(name, *arguments), timeout_s)

    def finish(self, process, timeout_s=60.0):
        """Wait for a command's end; returns its exit status."""
        try:
            return process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            pytest.fail(f"it did not end within {timeout_s} s:\n{self.output()[-4000:]}")

    def output(self):
        """What all commands of this test have printed."""
        path = self.directory / "output.txt"
        return path.read_text(errors="replace") if path.exists() else ""

    def enabled(self, *channels):
        """Channels of which every motor is enabled."""
        arms = self.rig.state()["arms"]
        return [c for c in channels or self.channels if all(m["enabled"] for m in arms[c]["motors"].values())]

    def wait(self, condition, process, timeout_s=100.0):
        """Wait until a condition holds, while a command runs."""
        wait(condition, timeout_s, self.output, process)

    def wait_enabled(self, process, *channels, timeout_s=60.0):
        """Wait until a command has energised these arms."""
        self.wait(lambda: self.enabled(*channels) == list(channels), process, timeout_s)

    def connected(self):
        """Whether the last command has connected its robot and its teleoperator: from then on leaders float."""
        return len(re.findall(r"Yam(?:Follower|Leader) connected\n", self.output()[self._said_before :])) == 2

    def wait_connected(self, process, timeout_s=60.0):
        """Wait until it has."""
        self.wait(self.connected, process, timeout_s)

    def assert_landed(self, but=()):
        """No motor is on, and cutting torque has moved no body by more than 1 cm, `but` of arms out of reach."""
        arms = self.rig.state()["arms"]
        on = [(c, name) for c in self.channels for name, motor in arms[c]["motors"].items() if motor["enabled"]]
        assert not on, f"still enabled: {on}\n{self.output()[-4000:]}"
        time.sleep(1.5)
        for channel in set(self.channels) - set(but):
            assert moved_after_cut_m(self.rig, channel) < MOST_M, f"{channel} fell\n{self.output()[-4000:]}"


@pytest.fixture
def commands(tmp_path):
    """On a rig without operator."""
    with running_rig() as rig, contextlib.closing(Commands(rig, tmp_path)) as commands:
        yield commands


@pytest.fixture(scope="module")
def shared_commands(tmp_path_factory):
    """On a rig with the scripted operator."""
    with running_rig(operator="pick_and_place") as rig:
        with contextlib.closing(Commands(rig, tmp_path_factory.mktemp("cli"))) as commands:
            yield commands
