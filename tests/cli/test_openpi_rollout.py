"""lerobot-rollout with a policy on an openpi server, a process of its own that dies or falls silent."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import yaml

from tests.cli.conftest import ROOT
from tests.support.openpi_server import RAISE_RAD, STEPS
from tests.support.rolling import FPS, Rollout

pytestmark = [pytest.mark.long, pytest.mark.alone]

HOLD_S = 0.6  # an arm that hears nothing holds after 0.5 s
STILL_RAD = 0.02  # what a held arm may still settle


class Server:
    """`tests/support/openpi_server.py` as a process."""

    def __init__(self, directory, *arguments):
        self.log = directory / "server.jsonl"
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.openpi_server", f"--log={self.log}", *arguments],
            cwd=ROOT,
            start_new_session=True,
        )
        deadline = time.monotonic() + 60.0
        while not (lines := self.lines()):
            assert self.process.poll() is None and time.monotonic() < deadline, "no openpi server came up"
            time.sleep(0.1)
        self.port = lines[0]["port"]

    def lines(self):
        text = self.log.read_text() if self.log.exists() else ""
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def questions(self):
        return [line for line in self.lines() if "number" in line]

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


class ServedRollout(Rollout):
    """lerobot-rollout on the virtual rig, driven by a server, without pictures: they share the CPU with the physics."""

    def begin(self, server, *arguments):
        document = yaml.safe_load((ROOT / "configs" / "sim" / "calibrate.yaml").read_text())
        document["policy"] = {"type": "yam_openpi", "host": "127.0.0.1", "port": server.port, "n_action_steps": STEPS}
        document |= {"fps": FPS, "task": "wave", "play_sounds": False}
        config = self.commands.directory / "rollout.yaml"
        config.write_text(yaml.safe_dump(document))
        self.start("lerobot-rollout", f"--config_path={config}", *arguments)

    def holds(self, seconds):
        """Whether both arms stay where they are for so long."""
        seen, until_s = [], time.monotonic() + seconds
        self.wait_until(lambda: seen.append([*map(self.joints, self.channels)]) or time.monotonic() > until_s)
        return np.ptp(seen, axis=0).max() < STILL_RAD


@pytest.fixture
def server(tmp_path, request):
    server = Server(tmp_path, *getattr(request, "param", ()))
    yield server
    server.kill()


@pytest.fixture
def rollout(commands):
    rollout = ServedRollout(commands)
    yield rollout
    rollout.abandon()


def assert_asked(server):
    """The server saw what it was to see."""
    asked = server.questions()
    assert asked and all(question["prompt"] == "wave" for question in asked)
    states = np.array([question["state"] for question in asked])
    assert states.shape[1] == 14 and np.ptp(states[:, 1]) > 0.05  # it saw the arm move


@pytest.mark.parametrize("engine", ["sync", "rtc"])
def test_a_killed_server(rollout, server, engine):
    ahead = [f"--inference.queue_threshold={STEPS // 2}"] if engine == "rtc" else []
    rollout.begin(server, f"--inference.type={engine}", *ahead)
    rollout.wait_moved(0.6 * 2 * RAISE_RAD)
    rollout.wait_until(lambda: len(server.questions()) > 3)
    server.kill()
    assert_asked(server)
    named, output = f"openpi server 127.0.0.1:{server.port}", rollout.commands.output
    if engine == "sync":  # the error ends the rollout at the next question; LeRobot takes the arms back and lands them
        assert rollout.end() == 1
        assert f"error: the {named} has closed the connection" in output().splitlines()[-1]
    else:  # LeRobot asks again for 5 s before it gives up: the arms hold, then it ends as usual
        rollout.watch(2 * STEPS / FPS + HOLD_S)  # what was queued is still executed
        assert rollout.holds(1.5)
        assert rollout.end() == 0 and f"the {named} cannot be reached" in output()
    rollout.assert_ended_well()


@pytest.mark.parametrize("server", [("--silent-after=8",)], indirect=True)
def test_a_silent_server(rollout, server):
    rollout.begin(server, "--policy.response_timeout_s=4")
    rollout.wait_until(lambda: len(server.questions()) == 9, 100.0)  # right after the last command
    rollout.watch(HOLD_S)
    assert rollout.holds(3.0)
    assert rollout.end() == 1
    named = f"openpi server 127.0.0.1:{server.port} has not answered within 4 s"
    assert named in rollout.commands.output().splitlines()[-1], rollout.commands.output()[-4000:]
    rollout.assert_ended_well()
