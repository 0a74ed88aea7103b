"""An episode is sent to an arm of a rig in lock-step from the page's data part."""

import time

import numpy as np
import pytest

from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, OpenedDataset, RecordedEpisode
from lerobot_robot_yam.viewer.data.recorded_arms import recorded_arms
from lerobot_robot_yam.viewer.data.replay_desk import ReplayDesk
from lerobot_robot_yam.viewer.data.session_driver import SessionDriver
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support import seeded_sets as seeds
from tests.support.paths import ROOT
from tests.support.rigged import lockstep_rig, sim_config

FOLLOWER = "follower_left"
rig = lockstep_rig(FOLLOWER)


@pytest.fixture
def desk(rig):
    """With an episode of this arm, and a driver for it."""
    names = [name.removeprefix("left_") for name in seeds.names(("left_",))]
    feature = {"dtype": "float32", "names": names}
    data = OpenedDataset(ROOT, {"fps": seeds.FPS, "features": {ACTION: feature, STATE: feature}})
    action, state = seeds.motion(0, ("left_",))
    config = sim_config(rig, FOLLOWER)
    driver = SessionDriver({"": config}, "lockstep")
    page = Page(port=0)
    arms = recorded_arms(data, {"": config}, "yam", "linear_4310")
    desk = ReplayDesk(page.server, driver, arms, data.fps, lambda work: work())
    rows = {ACTION: action, STATE: state, "frame_index": np.arange(len(action))}
    desk.open(RecordedEpisode(0, {}, rows, {}))
    yield desk
    desk.close()
    page.close()


def until(desk, condition):
    deadline = time.monotonic() + 60
    while not condition(desk._driver.state):
        assert time.monotonic() < deadline, desk._driver.state
        desk.update([])
        time.sleep(0.005)
    desk.update([])


def test_an_episode_is_replayed_and_the_arms_are_landed(desk):
    desk.update(None)
    assert desk._send.visible and not desk._land.visible
    desk._start(desk._episode, 2.0, None)
    until(desk, lambda state: state.running)
    assert desk._pause.visible and not desk._send.visible
    until(desk, lambda state: not state.running)
    assert "replayed" in desk._said.content and desk._land.visible
    end = desk._episode.rows[ACTION][-1]
    reached = np.array(desk._driver._session[FOLLOWER].published().setpoints)
    assert np.abs(reached - end).max() < 0.01
    desk._carefully(desk._driver.land)
    until(desk, lambda state: not state.running)
    assert "landed" in desk._said.content and not desk._land.visible


def test_a_browser_that_goes_pauses_its_replay(desk):
    desk._start(desk._episode, 0.1, 7)  # of this browser nothing is left
    until(desk, lambda state: state.running and state.paused)
    assert "browser" in desk._said.content and desk._pause.label == "go on"
    desk._starter = None
    desk._toggle()
    desk.update([])
    assert not desk._driver.state.paused and desk._pause.label == "pause"


def test_what_cannot_be_replayed_is_said_and_nothing_is_energised(desk):
    desk._episode.rows[ACTION][5, 2] = np.nan
    desk._start(desk._episode, 1.0, None)
    desk.update([])
    assert "row 5" in desk._said.content and not desk._driver.state.energised


def test_the_question_names_the_arms_and_what_was_found(desk):
    desk.update(None)
    text = desk._warning(desk._episode, 0.5)
    assert FOLLOWER in text and "6 s" in text and "not checked yet" in text
