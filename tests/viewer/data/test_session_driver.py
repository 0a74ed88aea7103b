"""A recorded motion on arms of a rig in lock-step: approach, way, pause, end, emergency stop."""

import time

import numpy as np
import pytest

from lerobot_robot_yam.errors import ActionError, LifeCycleError
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.data.session_driver import SessionDriver
from tests.support.rigged import lockstep_rig, sim_config

FOLLOWER = "follower_left"
THERE = np.array([0.1, 0.7, 0.7, -0.2, 0.1, 0.1, 0.4])
rig = lockstep_rig(FOLLOWER)


def way(seconds=2.0, far=0.3):
    """From a pose on with joint 1, there and back."""
    times = np.arange(round(seconds * 30)) / 30
    rows = np.tile(THERE, (len(times), 1))
    rows[:, 0] += far * np.sin(np.pi * times / seconds)
    return Trajectory(times, rows)


@pytest.fixture
def driver(rig):
    driver = SessionDriver({"": sim_config(rig, FOLLOWER)}, "lockstep")
    yield driver
    EmergencyStop().release()
    driver.close()


def until(driver, condition):
    deadline = time.monotonic() + 60
    while not condition(driver.state):
        assert time.monotonic() < deadline, driver.state
        time.sleep(0.002)
    return driver.state


def q(driver):
    return driver._session[FOLLOWER].published().q


def test_a_recording_is_replayed_and_the_arm_holds_at_its_end(driver):
    assert not driver.state.energised
    driver.replay({"": way()})
    state = until(driver, lambda state: not state.running)
    assert "replayed" in state.text and state.energised and state.share == 1.0
    assert np.abs(q(driver) - THERE[:6]).max() < 0.05
    assert driver._session[FOLLOWER].mode() is Mode.HOLD
    driver.land()
    assert until(driver, lambda state: not state.running).text == "landed"
    assert not driver.state.energised


def test_a_pause_holds_on_the_way_until_it_goes_on(driver):
    driver.replay({"": way(6.0)})
    until(driver, lambda state: state.share > 0.5)
    driver.pause()
    time.sleep(0.3)
    share, there = driver.state.share, q(driver)
    time.sleep(0.3)
    assert driver.state.running and driver.state.paused
    assert driver.state.share == share < 1.0 and np.abs(q(driver) - there).max() < 0.01
    with pytest.raises(LifeCycleError, match="busy"):
        driver.replay({"": way()})
    driver.resume()
    assert "replayed" in until(driver, lambda state: not state.running).text


def test_an_end_or_an_emergency_stop_on_the_way_leaves_the_arm_held(driver):
    driver.replay({"": way(6.0)})
    until(driver, lambda state: state.share > 0.3)
    driver.end()
    assert "ended" in until(driver, lambda state: not state.running).text
    assert driver._session[FOLLOWER].mode() is Mode.HOLD
    driver.replay({"": way(6.0)})
    until(driver, lambda state: state.share > 0.1)
    EmergencyStop().latch("a test")
    assert "stopped" in until(driver, lambda state: not state.running).text
    assert driver._session[FOLLOWER].mode() is Mode.STOPPED


def test_what_does_not_fit_is_refused_before_anything_is_energised(driver):
    for wrong in ({"left_": way()}, {"": way(far=9.0)}):
        with pytest.raises(ActionError):
            driver.replay(wrong)
    assert not driver.state.running and not driver.state.energised
