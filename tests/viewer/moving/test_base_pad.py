"""The page drives a base while a browser that controls it holds a button down."""

import numpy as np
import pytest

from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.moving.control_desk import Stage
from lerobot_robot_yam.viewer.moving.driving_plan import plan_of, plan_of_file
from tests.support.rigged import base_on, rig_of
from tests.viewer.conftest import Station

ROUND_S = 0.02


@pytest.fixture
def railed(request):
    """Whether the base has a rail."""
    return getattr(request, "param", False)


@pytest.fixture
def rig(railed):
    with rig_of("lockstep", scene="mobile", rail=railed) as rig:
        yield rig


@pytest.fixture
def station(rig, railed, tmp_path):
    base = base_on(rig, rail={"io": "sim"} if railed else None)
    station = Station(rig, tmp_path, plan_of([], tmp_path / "poses.json", base))
    station.pace_s = ROUND_S
    yield station
    station.close()


def state(station):
    return station.driver.session.bases[0].published()


def held(station, browser, label, until, rounds=150):
    """Hold a button down until this is so."""
    for number in range(rounds):
        if until():
            return
        if number % 2 == 0:
            browser.hold(label)
        station.round()
    raise AssertionError(state(station), browser.notices)


def rests(station):
    return lambda: np.abs(state(station).planned).max() < 1e-6


@pytest.fixture
def browser(station):
    browser = station.browser()
    browser.hold("forward")
    station.run(lambda: browser.was_told("press `connect …` and confirm it"))
    assert station.driver.desk.stage is Stage.WATCHING and not station.driver.session.running
    station.take_control(browser)
    return browser


def test_a_base_drives_while_a_button_is_held_and_for_the_browser_in_control_only(station, browser):
    held(station, browser, "forward", lambda: state(station).planned[0] > 0.1)
    station.run(rests(station))
    gone = state(station).pose[0]
    assert 0.05 < gone < 0.5 and state(station).mode is Mode.HOLD
    other = station.browser()
    for _ in range(10):
        other.hold("forward")
        station.round()
    assert other.was_told("browser 0 controls the arms") and rests(station)()
    held(station, browser, "turn left", lambda: state(station).planned[2] > 0.2)
    station.run(rests(station))
    browser.press("land")
    station.run(lambda: browser.was_told("torque is off"))
    assert not station.driver.session.running


@pytest.mark.parametrize("end", ["closed", "frozen", "stalled"])
def test_a_base_brakes_at_once_when_the_browser_that_drives_it_is_lost(station, browser, end):
    held(station, browser, "left", lambda: state(station).planned[1] > 0.1)
    clock = station.driver.session.clock
    if end == "closed":
        browser.close()
    elif end == "frozen":
        browser.alive = False
    else:
        browser.stalled = True
        for _ in range(10):
            browser.hold("left")  # the network keeps them
    begin_s = clock.now()
    while clock.now() < begin_s + 0.3:
        station.round()
    station.run(rests(station))
    assert clock.now() - begin_s < 0.3 + 0.25 + 0.2 / 0.25
    place = state(station).pose
    browser.stalled = False
    for _ in range(20):
        station.round()
    assert state(station).pose == pytest.approx(place, abs=2e-3)


def test_an_emergency_stop_reaches_a_base_and_a_button_that_is_still_held_does_not_move_it(station, browser):
    held(station, browser, "forward", lambda: state(station).planned[0] > 0.1)
    EmergencyStop().latch("test")
    held(station, browser, "forward", lambda: browser.was_told("emergency stop is latched"))
    station.run(lambda: state(station).mode is Mode.STOPPED)
    EmergencyStop().release()
    held(station, browser, "forward", lambda: browser.was_told("let go of the button first"))
    for _ in range(round(1.0 / ROUND_S)):  # longer than the time after which a button counts as let go
        browser.hold("forward")
        station.round()
    assert rests(station)()
    for _ in range(round(0.6 / ROUND_S)):
        station.round()
    held(station, browser, "forward", lambda: state(station).planned[0] > 0.1)


@pytest.mark.long
@pytest.mark.parametrize("railed", [True], indirect=True)
def test_the_rail_moves_once_it_is_homed(station, browser):
    browser.hold("rail up")
    station.run(lambda: browser.was_told("not homed"))
    browser.press("home the rail (it goes all the way up and down)")
    station.pace_s = 0.002
    station.run(lambda: state(station).rail.homed)
    before, station.pace_s = state(station).rail.height_m, ROUND_S
    held(station, browser, "rail up", lambda: state(station).rail.height_m > before + 0.05)


def test_a_run_config_names_the_base_that_is_driven(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("robot: {type: yam_base, channel: can_base}")
    plan = plan_of_file(path, None)
    assert plan.base.channel == "can_base" and plan.configs == () and plan.parts == (plan.base,) and not plan.notes
