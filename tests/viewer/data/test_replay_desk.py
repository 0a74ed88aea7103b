"""Episodes of a data set are sent to an arm of the virtual rig, asked by browsers through their WebSockets."""

import numpy as np
import pytest

from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, OpenedDataset, RecordedEpisode
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.data.recorded_arms import recorded_arms
from lerobot_robot_yam.viewer.data.replay_desk import ReplayDesk
from tests.support import seeded_sets as seeds
from tests.support.paths import ROOT
from tests.support.rigged import sim_config
from tests.support.tiers import spread
from tests.viewer.conftest import ARM

ROWS = 80
THERE = np.array([0.1, 0.7, 0.7, -0.2, 0.1, 0.1, 0.4])


class Sent:
    """A replay desk on the page of a station, with one episode: from a pose on with joint 1, there and back."""

    def __init__(self, station, rig):
        self.station = station
        names = [name.removeprefix("left_") for name in seeds.names(("left_",))]
        feature = {"dtype": "float32", "names": names}
        data = OpenedDataset(ROOT, {"fps": seeds.FPS, "features": {ACTION: feature, STATE: feature}})
        arms = recorded_arms(data, {"": sim_config(rig, ARM)}, "yam", "linear_4310")
        rows = np.tile(THERE, (ROWS, 1))
        rows[:, 0] += 0.3 * np.sin(np.linspace(0.0, np.pi, ROWS))
        self.episode = RecordedEpisode(0, {}, {ACTION: rows, STATE: rows, "frame_index": np.arange(ROWS)}, {})
        self.desk = ReplayDesk(station.page.server.gui, station.driver, [""], arms, data.fps)
        self.desk.open(self.episode)
        station.parts.append(self)

    def update(self):
        self.desk.update(None)

    @property
    def replayed(self):
        return self.station.driver.replayed

    def send(self, browser, speed):
        """Confirm that it is sent, and wait until it is on its way."""
        browser.set("speed of the arms", speed)
        browser.press("send to the arms …")
        self.confirm(browser)
        self.station.run(lambda: self.replayed is not None)

    def confirm(self, browser):
        """Answer the question."""
        self.station.run(lambda: "move the arms" in browser.labels())
        browser.press("move the arms")


@pytest.fixture
def sent(station, rig):
    return Sent(station, rig)


def test_an_episode_is_replayed_and_the_arm_holds_at_its_end(station, sent, controlling):
    sent.send(controlling, 2.0)
    station.run(lambda: controlling.was_told("replayed; the arms hold"))
    assert sent.replayed is None and station.state.mode is Mode.HOLD
    np.testing.assert_allclose(station.state.setpoints, THERE, atol=1e-3)
    np.testing.assert_allclose(station.state.q, THERE[:6], atol=0.05)


def test_nothing_is_sent_by_a_browser_that_does_not_control_the_arms(station, sent, controlling):
    other, before = station.browser(), station.state.setpoint_q
    other.press("send to the arms …")
    station.run(lambda: other.was_told("browser 0 controls the arms"))
    for _ in range(20):
        station.round()
    assert not other.shows("These arms move") and sent.replayed is None
    np.testing.assert_array_equal(station.state.setpoint_q, before)


@pytest.mark.long
def test_a_pause_rests_on_the_way_until_it_goes_on(station, sent, controlling):
    sent.send(controlling, 1.0)
    station.run(lambda: sent.replayed.share > 0.5)
    controlling.press("pause")
    station.run(lambda: sent.replayed.paused)
    for _ in range(30):
        station.round()
    share, there = sent.replayed.share, station.state.q
    for _ in range(30):
        station.round()
    assert sent.replayed.share == share < 1.0
    np.testing.assert_allclose(station.state.q, there, atol=0.01)
    controlling.press("go on")
    station.run(lambda: controlling.was_told("replayed"))


@pytest.mark.parametrize("end", spread(["button", "slider", "emergency stop", "lost browser"], 2))
def test_what_ends_a_replay_ends_it_for_good(station, sent, controlling, end):
    sent.send(controlling, 1.0)
    station.run(lambda: sent.replayed.share > 0.3)
    if end == "button":
        controlling.press("end, and hold")
    elif end == "slider":
        controlling.set("joint_6, rad", 0.3)
    elif end == "emergency stop":
        EmergencyStop().latch("test")
    else:
        controlling.close()
    station.run(lambda: sent.replayed is None)
    EmergencyStop().release()
    station.run(lambda: station.state.mode is Mode.HOLD)
    there = station.state.q
    for _ in range(20):
        station.round()
    assert sent.replayed is None
    np.testing.assert_allclose(station.state.q[:5], there[:5], atol=0.02)


def test_an_episode_that_cannot_be_replayed_is_refused_and_nothing_moves(station, sent, controlling):
    before = station.state.setpoint_q
    sent.episode.rows[ACTION][5, 2] = np.nan
    controlling.press("send to the arms …")
    sent.confirm(controlling)
    assert controlling.shows("not checked yet") and controlling.shows(ARM)
    station.run(lambda: controlling.was_told("row 5"))
    sent.desk.open(RecordedEpisode(1, {}, {ACTION: np.tile(THERE + 9.0, (ROWS, 1))}, {}))
    controlling.press("send to the arms …")
    sent.confirm(controlling)
    station.run(lambda: controlling.was_told("nothing moves"))
    assert sent.replayed is None
    np.testing.assert_array_equal(station.state.setpoint_q, before)
