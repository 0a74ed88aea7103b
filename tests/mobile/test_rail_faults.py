"""Faults of the rail's motor, brake, switches and board while it homes, holds or moves: named, and nothing falls."""

import contextlib

import pytest

from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.state.base_records import BaseRequest
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from tests.mobile.rails import MOST_FALL_M, Rail, lift

PHASES = ("homing", "hold", "move")
RAIL_M_S = {"hold": 0.0, "move": 0.3}
FAULTS = {  # channel, motor, kind, value, what is said
    "upper stuck": (
        "base_io",
        None,
        "switches",
        {"upper": True},
        "the upper switch (reads as|stays) triggered.* stuck",
    ),
    "lower stuck": ("base_io", None, "switches", {"lower": True}, "the lower switch (reads as|was) triggered"),
    "cable off": ("base_io", None, "switches", {"upper": True, "lower": True}, "both switches .* cable is off"),
    "board silent": ("base_io", None, "handle_silent", True, "switches and brake not heard for"),
    "board's cable out": ("base_io", None, "cable_out", True, "switches and brake not heard for"),
    "board's link down": ("base_io", None, "link_down", True, "switches and brake not heard for"),
    "motor without power": ("base", "rail", "power", False, r"rail \(id 9\)"),
    "motor silent": ("base", "rail", "silent", True, r"rail \(id 9\)"),
    "motor in over-current": ("base", "rail", "nibble", 0xA, r"rail \(id 9\)"),
    "motor stuck": ("base", "rail", "stuck", True, "motor 9 is .* rad from where it should be"),
}
QUICK = {("cable off", "homing"), ("motor without power", "move"), ("motor silent", "hold"), ("board silent", "move")}
CASES = [
    pytest.param(name, phase, marks=() if (name, phase) in QUICK else pytest.mark.long)
    for name in FAULTS
    for phase in PHASES
    if (name, phase) != ("motor stuck", "hold")  # it does not show while nothing moves
]


@pytest.fixture
def rail(tmp_path):
    rail = Rail(tmp_path)
    with contextlib.closing(rail.rig):
        yield rail


def begin(rail, base, phase):
    """Bring the rail into a phase of its life, and begin to watch it."""
    if phase == "homing":
        base._client.request(BaseRequest.HOME_RAIL)
        base.clock.sleep(0.5)
    else:
        lift(base, RAIL_M_S[phase], 0.5)
    rail.watch_fall()


@pytest.mark.parametrize("name, phase", CASES)
def test_a_fault_stops_the_rail_by_name_and_it_moves_again_once_it_is_over(rail, name, phase):
    channel, motor, kind, value, why = FAULTS[name]
    with rail.base() as base:
        begin(rail, base, phase)
        rail.rig.fault(channel, motor, kind, value)
        base.clock.sleep(1.0)
        state = base._client.published()
        assert state.mode is Mode.FAULT
        with pytest.raises(MotorError, match=why):
            base.set_rail_velocity(0.1)
        there = rail.height_m
        if (name, phase) == ("upper stuck", "homing"):  # it drove down, away from the switch
            rail.watch_fall()
        base.clock.sleep(1.0)
        assert rail.height_m == pytest.approx(there, abs=1e-3) and rail.fallen_m < MOST_FALL_M
        assert rail.board.brake_on or state.trouble is Trouble.RAIL_SILENT
        rail.rig.clear_faults(channel)
        base.clock.sleep(0.1)
        base.rearm()
        base.clock.sleep(0.5)
        assert rail.fallen_m < MOST_FALL_M and base.observe().trouble is None
        if base.rail_state().homed:
            lift(base, 0.3, 0.5)
            assert rail.height_m > there + 0.05
        else:  # switch or height may be wrong
            assert phase == "homing" or state.trouble is Trouble.RAIL_SWITCH


@pytest.mark.parametrize(
    "phase", ["move", *(pytest.param(phase, marks=pytest.mark.long) for phase in ("homing", "hold"))]
)
def test_a_brake_that_does_not_hold_at_an_emergency_stop(rail, phase):
    with rail.base() as base:
        begin(rail, base, phase)
        rail.rig.fault("base_io", None, "brake_slips", True)
        EmergencyStop().latch("a test")
        try:
            base.clock.sleep(2.0)
            state = base._client.published()
            assert state.mode is Mode.FAULT and state.trouble is Trouble.RAIL_BRAKE and rail.enabled
            assert rail.fallen_m < MOST_FALL_M
        finally:
            EmergencyStop().release()
            rail.rig.clear_faults("base_io")
        base.rearm()
        base.clock.sleep(0.5)
        assert rail.fallen_m < MOST_FALL_M and base.observe().mode is Mode.HOLD
