"""LeRobot's commands driven from the handles alone, without a terminal: what is kept agrees with the rig's own log."""

import json
import sys
import time

import numpy as np
import pytest
import yaml
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.face.recorder import outcomes
from tests.cli.conftest import CALM, ROOT
from tests.support.waiting import wait

pytestmark = pytest.mark.alone

FPS, SECONDS, RESET_S = 15, 60, 60
BUTTONS = {"next": "left_bottom", "failure": "right_bottom", "rerecord": "left_top", "stop": "right_top"}
IN_RIG = {"top": "sync", "bottom": "record"}

MEANINGS = {button: meaning for meaning, button in BUTTONS.items()}


def press(rig, button):
    """Press a button such as left_top, as a thumb does; the rig logs it."""
    side, _, name = button.partition("_")
    rig.press(f"leader_{side}", IN_RIG[name], 0.1)


def pressed(rig, since=0):
    """The buttons that were pressed, as the rig has logged it, with the times."""
    names = {value: key for key, value in IN_RIG.items()}
    return [
        (f"{event['channel'].removeprefix('leader_')}_{names[event['button']]}", event["monotonic_s"])
        for event in rig.events(since)
        if event["kind"] == "button" and event["down"]
    ]


class Handles:
    """A recording, and thumbs on the handles of its leaders."""

    def __init__(self, commands, **teleop):
        self.commands, self.rig, self.root = commands, commands.rig, commands.directory / "data"
        config = yaml.safe_load((ROOT / "configs" / "sim" / "record.yaml").read_text())
        config["robot"]["cameras"] = {}
        for side in ("left_arm_config", "right_arm_config"):
            del config["teleop"][side]["can_options"]
        config["teleop"] |= teleop
        config["dataset"] |= {"root": str(self.root), "no_stamp": True, "fps": FPS, "num_episodes": 10}
        config["dataset"] |= {"episode_time_s": SECONDS, "reset_time_s": RESET_S}
        self.config = commands.directory / "record.yaml"
        self.config.write_text(yaml.safe_dump(config))
        self.process = None

    def start(self):
        self.process = self.commands.start("lerobot-record", f"--config_path={self.config}", *CALM)
        self.commands.wait_connected(self.process, timeout_s=200.0)

    def press(self, meaning):
        """Press the button that means this; the rig logs it."""
        press(self.rig, BUTTONS[meaning])

    def time_of(self, text, count):
        """When it has said something, the so-manieth time, to a millisecond."""
        path, deadline = self.commands.directory / "output.txt", time.monotonic() + 10.0
        while path.read_bytes().count(text.encode()) < count:
            assert time.monotonic() < deadline, self.commands.output()[-4000:]
            time.sleep(0.001)
        return time.monotonic()

    def wait_said(self, text, count=1, timeout_s=60.0):
        self.commands.wait(lambda: self.commands.output().count(text) >= count, self.process, timeout_s)

    def wait_recording(self, episode, count=1):
        """Wait until an episode is recorded, for the so-manieth time, and record a second of it."""
        self.wait_said(f"Recording episode {episode}\n", count)
        time.sleep(1.0)

    def wait_resetting(self, count):
        self.wait_said("Reset the environment", count)
        time.sleep(0.3)

    def abandon(self):
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
            self.rig.end()


@pytest.fixture
def handles(commands):
    made = []

    def make(**teleop):
        made.append(Handles(commands, **teleop))
        return made[-1]

    yield make
    for one in made:
        one.abandon()


@pytest.mark.long
def test_a_session_from_the_handles_alone(handles):
    session = handles(buttons=BUTTONS)
    session.start()
    session.wait_recording(0)
    session.press("next")
    session.wait_resetting(1)
    session.press("next")
    session.wait_recording(1)
    session.press("rerecord")
    session.wait_resetting(2)
    session.press("next")
    session.wait_recording(1, count=2)
    session.press("failure")
    session.wait_resetting(3)
    session.press("next")
    session.wait_recording(2)
    session.press("stop")
    assert session.commands.finish(session.process) == 0, session.commands.output()[-4000:]
    session.commands.assert_landed()
    meanings = [MEANINGS[button] for button, _ in pressed(session.rig)]
    assert meanings == ["next", "next", "rerecord", "next", "failure", "next", "stop"]
    data = LeRobotDataset("local/yam_sim", root=session.root)
    assert data.num_episodes == 3 and all(row["length"] >= 0.5 * FPS for row in data.meta.episodes)
    (labelled,) = outcomes.read(session.root).values()
    assert (labelled.episode_index, labelled.outcome, labelled.by) == (1, "failure", BUTTONS["failure"])
    figures = [json.loads(line) for line in (session.root / "meta" / "yam_episodes.jsonl").read_text().splitlines()]
    assert [row["frames"] for row in figures] == [row["length"] for row in data.meta.episodes]


PRESSES = 100


@pytest.mark.long
def test_a_button_is_an_event_of_lerobot_within_50_ms(handles, monkeypatch):
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")  # it says at once which key it has heard
    session = handles(buttons=BUTTONS)
    session.start()
    session.wait_recording(0)
    since, heard = session.rig.events()[-1]["number"] + 1, []
    for turn in range(PRESSES // 2):
        for meaning, said, then, count in (
            ("rerecord", "Left arrow key pressed", "Reset the environment", turn + 1),
            ("next", "Right arrow key pressed", "Recording episode 0\n", turn + 2),
        ):
            session.press(meaning)
            heard.append(session.time_of(said, turn + 1))
            session.wait_said(then, count)
            time.sleep(0.25)
    session.press("stop")
    assert session.commands.finish(session.process) == 0, session.commands.output()[-4000:]
    times = [at_s for _, at_s in pressed(session.rig, since)][:PRESSES]
    latencies = sorted(1e3 * (heard_s - at_s) for heard_s, at_s in zip(heard, times, strict=True))
    median, p99, longest = latencies[PRESSES // 2], latencies[-2], latencies[-1]
    sys.stdout.write(f"button to event: median {median:.1f} ms, p99 {p99:.1f}, longest {longest:.1f}\n")
    assert latencies[-2] < 50.0, latencies


UP_RAD = {"left": [0.2, 1.1, 1.0, -0.4, 0.1, 0.2], "right": [-0.2, 1.1, 1.0, -0.4, 0.1, 0.2]}
LIFT_S = 1.2
HELD_S = 2.0


class LiftedSession(Handles):
    """A recording with automatic episodes, and hands that lift both leaders and bring them home."""

    def __init__(self, commands):
        super().__init__(commands, buttons=BUTTONS, auto_episodes=True)
        config = yaml.safe_load(self.config.read_text())
        for side in ("left", "right"):
            config["teleop"][f"{side}_arm_config"] |= {"follower": f"follower_{side}", "gate": "auto"}
        config["dataset"]["reset_time_s"] = 6  # shorter than a wait: LeRobot then begins by itself, and is sent back
        self.config.write_text(yaml.safe_dump(config))

    def lift(self):
        """Lift both leaders, and hold them up."""
        self.rig.log("lifted")
        for side, pose in UP_RAD.items():
            self.rig.hand(f"leader_{side}", [LIFT_S], [pose])
        time.sleep(LIFT_S + HELD_S)

    def bring_home(self):
        """Bring both home, and let go."""
        for side in UP_RAD:
            self.rig.hand(f"leader_{side}", [LIFT_S], [[0.0] * 6])
        time.sleep(LIFT_S + 1.0)
        for side in UP_RAD:
            self.rig.release(f"leader_{side}")

    def wait_saved(self, episodes):
        info = self.root / "meta" / "info.json"
        wait(lambda: json.loads(info.read_text())["total_episodes"] >= episodes, 30.0, self.commands.output)


@pytest.fixture
def lifting(commands):
    session = LiftedSession(commands)
    yield session
    session.abandon()


@pytest.mark.long
def test_a_session_from_lifts(lifting):
    lifting.start()
    lifting.wait_resetting(1)  # the episode that LeRobot has begun is sent back
    time.sleep(8.0)  # longer than the reset
    lifting.lift()
    lifting.bring_home()
    lifting.wait_saved(1)
    lifting.lift()
    lifting.press("failure")
    lifting.wait_saved(2)
    lifting.bring_home()
    lifting.lift()
    lifting.press("rerecord")
    lifting.bring_home()
    time.sleep(1.0)
    lifting.lift()
    lifting.bring_home()
    lifting.wait_saved(3)
    time.sleep(1.0)
    lifting.press("stop")
    assert lifting.commands.finish(lifting.process) == 0, lifting.commands.output()[-4000:]
    lifting.commands.assert_landed()
    assert sum(event["kind"] == "lifted" for event in lifting.rig.events()) == 4
    data = LeRobotDataset("local/yam_sim", root=lifting.root)
    assert {episode: row.outcome for episode, row in outcomes.read(lifting.root).items()} == {1: "failure"}
    assert data.num_episodes == 3
    table = data.hf_dataset.with_format("numpy")
    index, shoulder = np.array(table["episode_index"]), np.stack(table["observation.state"])[:, 1]
    for episode in range(3):
        lift = shoulder[index == episode]
        assert lift[0] < 0.3 and lift.max() > 1.0  # from home
        assert len(lift) < 1.5 * FPS * (2 * LIFT_S + HELD_S + 1.0)
        if episode != 1:  # whose label has ended it
            assert lift[-1] < 0.6
