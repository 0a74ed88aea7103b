"""LeRobot's commands labelled, led on and ended by requests alone: nobody presses a key or a button."""

import os
import signal
import subprocess
import sys
import time

import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.face.recorder.disk_guard import LEFT_FREE
from lerobot_robot_yam.state.desk_post import Asked, ask, running_desks
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.cli.conftest import ROOT
from tests.support.rolling import Rollout, config, data_set

pytestmark = [pytest.mark.alone, pytest.mark.long]

FPS = 15
WAIT_S = 200.0


class Desk:
    """The desk of the one command that runs, as a page sees it."""

    def __init__(self, process=None):
        self.process, self.number, self.status = process, None, {}

    def look(self):
        running = running_desks(runtime_dir())
        self.number, self.status = next(iter(running.items()), (None, {}))
        return self.status

    def wait(self, seconds=0.0, **wanted):
        """Until the command says this, and has been in this phase for so long."""
        deadline = time.monotonic() + WAIT_S
        while wanted != {name: self.look().get(name) for name in wanted} or self.status.get("elapsed_s", 0.0) < seconds:
            assert self.process is None or self.process.poll() is None, self.status
            assert time.monotonic() < deadline, self.status
            time.sleep(0.05)
        return self.status

    def ask(self, meaning):
        """As a click, for the phase that is shown."""
        assert meaning in self.status["offers"], self.status
        assert ask(runtime_dir(), self.number, Asked(meaning, "yam-view", self.status["turn"]))


@pytest.fixture
def rollout(commands):
    rollout = Rollout(commands)
    yield rollout
    rollout.abandon()


def begin(rollout, **document):
    """Start a rollout of a policy that moves the arms, without a terminal; its desk."""
    name = "dagger" if document["strategy"]["type"] == "dagger" else "rollout"
    rollout.begin(config(name, **document), "sines", amplitude=0.3)
    return Desk(rollout.process)


def test_a_policys_episodes_are_labelled(rollout):
    dataset = data_set(rollout.root, num_episodes=2, episode_time_s=60, reset_time_s=60)
    desk = begin(rollout, strategy={"type": "episodic"}, dataset=dataset)
    desk.wait(2.0, phase="recording", saved=0)
    desk.ask("failure")
    desk.wait(0.5, phase="resetting")
    desk.ask("next")
    desk.wait(2.0, phase="recording", saved=1)
    desk.ask("success")
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_ended_well()
    assert [row.outcome for row in outcomes.read(rollout.root).values()] == ["failure", "success"]


def test_a_rollout_without_keys_can_be_ended(rollout):
    desk = begin(rollout, strategy={"type": "base"}, duration=600)
    status = desk.wait(3.0, phase="autonomous")
    assert set(status["offers"]) == {"stop"} and 590.0 < status["elapsed_s"] + status["left_s"] < 610.0
    desk.ask("stop")
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_ended_well()


def test_a_person_takes_over_from_a_policy_and_gives_back(rollout):
    dataset = data_set(rollout.root, num_episodes=1, episode_time_s=60, reset_time_s=1)
    desk = begin(rollout, strategy={"type": "dagger"}, dataset=dataset)
    desk.wait(2.0, phase="autonomous")
    desk.ask("correct")
    desk.wait(phase="correcting")
    rollout.watch(2.0)
    desk.ask("go_on")
    rollout.wait_said("Phase transition: correcting -> paused")
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    assert LeRobotDataset("local/rollout_test", root=rollout.root).num_episodes == 1


FILLED = """
import sys
from tests.support.armless import ArmlessConfig, record
record(sys.argv[1] + "/data", ArmlessConfig(size=(240, 320), noise=True), fps=10, num_episodes=1, episode_time_s=600,
       reset_time_s=1, video=False)
"""


def test_a_recording_on_a_small_disk_is_warned_of_before_it_ends(tmp_path):
    """A disk of its own, in a name space of its own: 50 MB are above what is left free, at about 2.3 MB/s."""
    (tmp_path / "small").mkdir()
    mount = 'mount -t tmpfs -o size=150m none "$SMALL" && exec "$@"'
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", mount, "sh", sys.executable, "-c", FILLED]
    if subprocess.run([*command[:3], "true"], capture_output=True).returncode:
        pytest.skip("this machine lets nobody mount a small disk for a test")
    environment = os.environ | {"SMALL": str(tmp_path / "small")}
    with open(tmp_path / "output.txt", "wb") as output:
        process = subprocess.Popen(
            [*command, tmp_path / "small"], env=environment, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT
        )
    desk, warned = Desk(), []
    deadline = time.monotonic() + WAIT_S
    while process.poll() is None:
        if time.monotonic() > deadline:
            process.send_signal(signal.SIGKILL)
        if "disk_warning" in desk.look():
            warned.append(desk.status)
        time.sleep(0.1)
    said = (tmp_path / "output.txt").read_text(errors="replace")
    assert process.returncode == 0 and "is almost full: the recording ends now" in said, said[-4000:]
    first = warned[0]
    assert "min of recording" in first["disk_warning"] and first["disk_left_s"] > 5.0
    assert first["disk_free_bytes"] > 1.1 * LEFT_FREE
