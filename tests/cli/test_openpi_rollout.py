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

pytestmark = [pytest.mark.long, pytest.mark.alone]

FPS = 15
ARMS = ("follower_left", "follower_right")
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


class Rollout:
    """lerobot-rollout on the virtual rig, driven by a server; and the arms as the rig saw them meanwhile."""

    def __init__(self, commands, server, *arguments):
        document = yaml.safe_load((ROOT / "configs" / "sim" / "calibrate.yaml").read_text())
        document["policy"] = {
            "type": "yam_openpi",
            "host": "127.0.0.1",
            "port": server.port,
            "n_action_steps": STEPS,
        }
        document |= {"fps": FPS, "task": "wave", "play_sounds": False}
        config = commands.directory / "rollout.yaml"
        config.write_text(yaml.safe_dump(document))
        self.commands, self.seen = commands, []
        self.process = commands.start("lerobot-rollout", f"--config_path={config}", *arguments)

    def watch(self, until, timeout_s=200.0):
        """Look at the arms until a condition holds or the command has ended; false then."""
        deadline = time.monotonic() + timeout_s
        while self.process.poll() is None:
            state = self.commands.rig.state()
            pose = np.concatenate([state["arms"][arm]["q"] for arm in ARMS])
            self.seen.append((state["monotonic_s"], pose, set(self.commands.enabled(*ARMS)) == set(ARMS)))
            if until():
                return True
            assert time.monotonic() < deadline, self.commands.output()[-4000:]
            time.sleep(0.02)
        return False

    def between(self, begin_s, end_s):
        """Poses (k, n) of all joints that the rig saw in a span of monotonic time."""
        return np.array([pose for stamp, pose, _ in self.seen if begin_s <= stamp <= end_s])

    def moved(self):
        """Range of each joint (n,) while the arms were energised, 0 if they never were."""
        poses = [pose for _, pose, energised in self.seen if energised]
        return np.ptp(poses, axis=0) if poses else np.zeros_like(self.seen[0][1])


@pytest.fixture
def server(tmp_path, request):
    server = Server(tmp_path, *getattr(request, "param", ()))
    yield server
    server.kill()


@pytest.fixture
def roll_out(commands, server):
    """Starts a rollout; a failed test leaves none behind."""
    started = []

    def start(*arguments):
        started.append(Rollout(commands, server, *arguments))
        return started[-1]

    yield start
    for rollout in started:
        rollout.process.kill()
        rollout.process.wait()


def waved(rollout):
    """Whether every arm has been raised about as far as the server says."""
    return bool((rollout.moved()[[1, 2, 7, 8]] > 0.6 * 2 * RAISE_RAD).all())


def assert_asked(server):
    """The server saw what it was to see."""
    asked = server.questions()
    assert asked and all(question["prompt"] == "wave" for question in asked)
    states = np.array([question["state"] for question in asked])
    assert states.shape[1] == 14 and np.ptp(states[:, 1]) > 0.05  # it saw the arm move


@pytest.mark.parametrize("engine", ["sync", "rtc"])
def test_a_killed_server(commands, server, roll_out, engine):
    ahead = [f"--inference.queue_threshold={STEPS // 2}"] if engine == "rtc" else []
    rollout = roll_out(f"--inference.type={engine}", *ahead)
    assert rollout.watch(lambda: waved(rollout) and len(server.questions()) > 3), commands.output()[-4000:]
    server.kill()
    killed_s = time.monotonic()
    assert_asked(server)
    rollout.watch(lambda: False)
    status = commands.finish(rollout.process)
    named = f"openpi server 127.0.0.1:{server.port}"
    if engine == "sync":  # the error ends the rollout at the next question; LeRobot takes the arms back and lands them
        assert status == 1
        assert f"error: the {named} has closed the connection" in commands.output().splitlines()[-1]
    else:  # LeRobot asks again for 5 s before it gives up: the arms hold, then it ends as usual
        assert status == 0 and f"the {named} cannot be reached" in commands.output()
        last_s = killed_s + 2 * STEPS / FPS  # what was queued is still executed
        held = rollout.between(last_s + HOLD_S, last_s + HOLD_S + 1.5)
        assert len(held) > 10 and np.ptp(held, axis=0).max() < STILL_RAD
    commands.assert_landed()


@pytest.mark.parametrize("server", [("--silent-after=8",)], indirect=True)
def test_a_silent_server(commands, server, roll_out):
    rollout = roll_out("--policy.response_timeout_s=4")
    rollout.watch(lambda: False)
    assert commands.finish(rollout.process) == 1
    named = f"openpi server 127.0.0.1:{server.port} has not answered within 4 s"
    assert named in commands.output().splitlines()[-1], commands.output()[-4000:]
    last = server.questions()[-1]
    assert last["number"] == 8
    asked_s = last["monotonic_s"]  # right after the last command
    held = rollout.between(asked_s + HOLD_S, asked_s + 3.9)
    assert len(held) > 30 and np.ptp(held, axis=0).max() < STILL_RAD
    commands.assert_landed()
