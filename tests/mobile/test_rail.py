"""The rail over CAN frames, in lock-step with its rig: homing, ends, brake, switches, faults; it never falls."""

import contextlib
import json
import math

import numpy as np
import pytest

from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError, MotorError
from lerobot_robot_yam.mobile.rail_profile import SOFT_END_M
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.base_records import BaseRequest
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from tests.mobile.rails import MOST_FALL_M, STROKE_M, Rail, lift
from tests.support.waiting import wait


@pytest.fixture
def rail(tmp_path):
    rail = Rail(tmp_path)
    with contextlib.closing(rail.rig):
        yield rail


@pytest.fixture
def base(rail):
    with rail.base() as base:
        rail.watch_fall()
        yield base


def place_in(rail):
    return json.loads(rail.path.read_text())["angle_rad"]


def test_homing_learns_the_scale_and_the_next_start_knows_the_height(tmp_path):
    rail = Rail(tmp_path, height_m=0.2, stroke_m=0.25, known=False)
    with contextlib.closing(rail.rig):
        with rail.base() as base:
            state = base.rail_state()
            assert not state.homed and math.isnan(state.height_m) and not state.brake_on
            with pytest.raises(LifeCycleError, match=r"rail: is not homed; call home_rail\(\)"):
                base.set_rail_velocity(0.1)
            with pytest.raises(LifeCycleError, match="is not homed"):
                base.set_rail_height(0.1)
            base.clock.sleep(0.2)
            assert rail.height_m == pytest.approx(0.2, abs=2e-3)  # nothing has moved by itself
            base.set_target_velocity([0.1, 0.0, 0.0])
            base.home_rail()
            state = base.rail_state()
            assert state.homed and state.height_m == pytest.approx(rail.height_m, abs=3e-3)
            assert rail.lowest_m > -5e-3 and not state.lower
            wait(lambda: rail.path.exists() and place_in(rail) is None)
            lift(base, 0.2, 0.5)
            base.clock.sleep(0.7)
            there = rail.height_m
        assert not rail.enabled and rail.height_m == pytest.approx(there, abs=1e-3)
        with rail.base() as base:
            assert base.rail_state().height_m == pytest.approx(rail.height_m, abs=4e-3)
        rail.move(0.2)  # by hand, while it was off
        with rail.base() as base:
            assert not base.rail_state().homed


def test_velocity_and_height_within_the_soft_ends(rail, base):
    lift(base, 0.4, 2.5)
    assert rail.height_m == pytest.approx(STROKE_M - SOFT_END_M, abs=2e-3) and not base.rail_state().upper
    assert base.observe().mode is Mode.TRACK
    lift(base, -0.4, 1.0)
    assert base.rail_state().velocity_m_s == pytest.approx(-0.4, abs=0.03)
    base.clock.sleep(0.25 + 0.4 / 0.5 + 0.1)  # time-out and planned braking
    there = rail.height_m
    base.clock.sleep(1.0)
    assert base.observe().mode is Mode.HOLD and rail.height_m == pytest.approx(there, abs=5e-4)
    for _ in range(60):
        assert base.set_rail_height(-3.0) == SOFT_END_M
        base.clock.sleep(0.05)
    assert rail.height_m == pytest.approx(SOFT_END_M, abs=2e-3) and not base.rail_state().lower


def test_a_raised_rail_slows_the_base(rail, base):
    for _ in range(60):
        base.set_target_velocity([0.5, 0.0, 0.0])
        base.clock.sleep(0.05)
    assert base.odometry().body_twist[0] == pytest.approx(0.5 * (1.0 - 0.7 * 0.2 / 0.7), abs=0.02)


def test_the_brake_takes_the_carriage_before_torque_is_cut(rail):
    with rail.base() as base:
        lift(base, 0.4, 0.5)
        rail.watch_fall()
    assert not rail.enabled and rail.board.brake_on and place_in(rail) is not None
    rail.rig.sleep(1.0)
    assert rail.fallen_m < 1e-3


def test_an_emergency_stop_in_motion_brakes_and_engages(rail, base):
    lift(base, -0.4, 0.8)
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        base.clock.sleep(0.3)
        there = rail.height_m
        rail.watch_fall()
        base.clock.sleep(1.0)
        state = base.rail_state()
        assert base.observe().mode is Mode.STOPPED and state.brake_on and rail.enabled
        assert base.set_rail_velocity(0.2) == 0.0 and base.set_rail_height(0.9) == state.height_m
    finally:
        stop.release()
    base.clock.sleep(1.0)
    assert rail.height_m == pytest.approx(there, abs=2e-3) and not base.rail_state().brake_on
    lift(base, 0.2, 0.5)
    assert rail.height_m > there + 0.03 and rail.fallen_m < 2e-3


@pytest.mark.parametrize("kind", ["cable_out", "link_down"])
def test_a_lost_channel_is_noticed_by_the_brake(rail, base, kind):
    lift(base, 0.0, 0.2)
    rail.watch_fall()
    rail.rig.fault("base", None, kind, True)
    base.clock.sleep(1.0)
    assert rail.board.brake_on and not rail.enabled and rail.fallen_m < MOST_FALL_M


@pytest.mark.parametrize("heavy", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_brake_that_slips_is_caught_and_nothing_is_cut(rail, heavy):
    if heavy:
        rail.world.model.body("base/mount").mass[:] *= 2.0
    base = rail.base().connect()
    rail.watch_fall()
    rail.rig.fault("base_io", None, "brake_slips", True)
    base._client.land()
    base.clock.sleep(3.0)
    state = base._client.published()
    assert state.trouble is Trouble.RAIL_BRAKE and "does not hold" in state.message and rail.enabled
    assert 1e-3 < rail.fallen_m < MOST_FALL_M
    there = rail.height_m
    base.clock.sleep(4.0)
    assert rail.height_m == pytest.approx(there, abs=1e-3) and rail.enabled
    base.rearm()
    base.clock.sleep(0.5)
    lift(base, -0.4, 3.0)  # down, where it can be cut
    assert rail.height_m == pytest.approx(SOFT_END_M, abs=2e-3)
    base._session.discard()


def test_no_torque_is_cut_while_the_brake_cannot_be_engaged(rail):
    base = rail.base().connect()
    rail.watch_fall()
    rail.rig.fault("base_io", None, "handle_silent", True)
    base.clock.sleep(0.3)
    with pytest.raises(LifeCycleError, match="torque is not cut: .*not heard"):
        base._client.land()
    base.clock.sleep(3.0)
    assert rail.enabled and rail.fallen_m < 1e-3
    rail.rig.fault("base_io", None, "handle_silent", False)
    base.clock.sleep(0.1)
    base._client.land()
    base.clock.sleep(3.0)
    assert not rail.enabled and rail.fallen_m < 1e-3
    base.close()


def test_both_switches_triggered_are_refused_before_anything_moves(rail):
    rail.rig.fault("base_io", None, "switches", {"upper": True, "lower": True})
    with pytest.raises(MotorError, match="both switches read as triggered: their cable is off"):
        rail.base().connect()
    assert not rail.enabled and rail.board.brake_on


def test_no_board_is_refused_before_anything_moves(rail):
    rail.rig.fault("base_io", None, "handle_silent", True)
    with pytest.raises(MotorError, match=r"switches and brake \(sim\) do not answer"):
        rail.base().connect()
    assert not rail.enabled


def homing_fails(rail, why, **fields):
    """Home with a fault that is there already; it must be named, and nothing may fall."""
    base = rail.base(**fields).connect()
    with pytest.raises(MotorError, match=why):
        base.home_rail()
    assert base._client.published().trouble is Trouble.RAIL_HOMING
    base.clock.sleep(0.2)
    rail.watch_fall()
    base.clock.sleep(0.6)
    assert rail.board.brake_on and rail.fallen_m < 1e-3 and rail.lowest_m > -0.03
    base._session.discard()


@pytest.mark.parametrize(
    "height_m, switches, fields, why",
    [
        (0.05, {"lower": True}, {}, "the lower switch stays triggered away from its end: .* wire is off"),
        (0.2, {"upper": True}, {}, "the upper switch stays triggered away from its end: .* wire is off"),
        (0.01, {}, {"direction": -1}, "the lower switch was triggered on the way to the upper one: set direction"),
    ],
)
def test_homing_names_what_is_wrong(tmp_path, height_m, switches, fields, why):
    rail = Rail(tmp_path, height_m, stroke_m=0.25, known=False)
    with contextlib.closing(rail.rig):
        rail.rig.fault("base_io", None, "switches", switches)
        homing_fails(rail, why, **fields)


def test_homing_stops_at_a_broken_switch_by_the_lag_of_the_motor(tmp_path):
    rail = Rail(tmp_path, 0.2, stroke_m=0.25, known=False)
    with contextlib.closing(rail.rig):
        rail.rig.fault("base_io", None, "switches", {"upper": False})
        base = rail.base().connect()
        with pytest.raises(MotorError, match="let the carriage run to the stop"):
            base.home_rail()
        base.clock.sleep(0.5)
        assert rail.board.brake_on
        base._session.discard()


def test_another_travel_than_earlier_is_refused(tmp_path):
    rail = Rail(tmp_path, 0.2, stroke_m=0.25)
    with contextlib.closing(rail.rig):
        rail.path.write_text(json.dumps({"stroke_m": 0.25, "travel_rad": 9.0}))
        homing_fails(rail, r"8\.\d+ rad between the switches, earlier 9.00 rad: a switch is triggered too early")


def test_a_stop_ends_homing(tmp_path):
    rail = Rail(tmp_path, 0.1, stroke_m=0.25, known=False)
    with contextlib.closing(rail.rig):
        with rail.base() as base:
            base._client.request(BaseRequest.HOME_RAIL)
            base.clock.sleep(0.3)
            assert base.rail_state().homing
            with pytest.raises(LifeCycleError, match="rail: is homing"):
                base.set_rail_velocity(0.1)
            base.hold()
            base.clock.sleep(0.5)
            state = base.rail_state()
            assert not state.homing and not state.homed and state.dq == pytest.approx(0.0, abs=0.05)


def test_what_is_refused(rail, base):
    for wrong in (math.nan, math.inf, "up", None, [0.1]):
        with pytest.raises(ActionError, match="base: rail velocity"):
            base.set_rail_velocity(wrong)
        with pytest.raises(ActionError, match="base: rail height"):
            base.set_rail_height(wrong)
    assert base.set_rail_velocity(9.0) == 0.5
    alone = YamBase(channel="base", interface="yam_lockstep", can_options={"rig": rail.rig.name}, isolation="lockstep")
    assert alone.config.rail is None


def test_a_base_without_a_rail(rail):
    with YamBase(
        channel="base", interface="yam_lockstep", can_options={"rig": rail.rig.name}, isolation="lockstep"
    ) as base:
        with pytest.raises(ConfigError, match="has no rail"):
            base.set_rail_velocity(0.1)
        assert base.observe().rail is None


def test_a_motor_that_forgot_its_turns_has_to_home_again(rail, base):
    lift(base, 0.4, 1.0)
    base.clock.sleep(1.2)
    motor = next(one for one in rail.rig.device.channels["base"].motors if one.name == "rail")
    rail.rig.fault("base", "rail", "power", False)
    base.clock.sleep(1.0)
    motor.zero_rad -= 4.0 * math.pi
    rail.rig.fault("base", "rail", "power", True)
    base.clock.sleep(0.5)
    base.rearm()
    assert not base.rail_state().homed
    with pytest.raises(LifeCycleError, match="is not homed"):
        base.set_rail_height(0.1)
    base._client.ask(BaseRequest.HOME_RAIL)  # at once, while the brake is being released
    before = base.rail_state().q
    base.clock.sleep(1.0)
    assert base.rail_state().homing and abs(base.rail_state().q - before) > 1.0


def test_a_carriage_that_went_on_while_its_channel_was_silent_has_no_slipping_brake(rail, base):
    lift(base, 0.4, 1.0)
    rail.rig.fault("base", None, "cable_out", True)
    base.clock.sleep(0.3)  # shorter than the motors' watchdog
    rail.rig.clear_faults("base")
    base.clock.sleep(0.5)
    assert base._client.published().trouble is Trouble.BUS_SILENT
    assert base._session.stop() and rail.board.brake_on and not rail.enabled


def test_the_base_takes_no_target_while_its_rail_homes(rail, base):
    client = base._client
    client.ask(BaseRequest.HOME_RAIL)
    base.clock.sleep(0.5)
    base.set_target_velocity([0.2, 0.0, 0.0])
    base.clock.sleep(0.6)
    state = base.observe()
    assert state.rail.homing and np.abs(state.planned).max() == 0.0
