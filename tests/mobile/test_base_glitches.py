"""Disturbances that are over within a few ticks, on base and rail in motion: neither stops, nor leaves its plan."""

import contextlib
import math

import numpy as np
import pytest

from lerobot_robot_yam.mobile.odometry import to_body
from lerobot_robot_yam.state.base_records import BaseRequest
from lerobot_robot_yam.state.modes import Mode
from tests.mobile.rails import MOST_FALL_M, Rail
from tests.support.tiers import spread

STEER, DRIVE, RAIL = "front_left_steer", "rear_right_drive", "rail"
TWIST, TURNED, LIFT_M_S = (0.3, 0.1, 0.3), (-0.3, 0.1, 0.3), 0.3
# Of x, y, theta and rail; wheels take up slip after a pause, and casters that turn round throw the base sideways.
MOST = {TWIST: np.array([1.1, 0.75, 2.3, 1.8]), TURNED: np.array([1.4, 0.9, 2.3, 1.8])}


def fault(kind, value, motor=None, **details):
    """A fault that ends by itself."""
    return lambda rig, base: rig.fault("base", motor, kind, value, **details)


def tick(kind, value, motor=None, channel="base", **details):
    """A fault that lasts for one tick."""

    def cause(rig, base):
        rig.fault(channel, motor, kind, value, **details)
        base.clock.sleep(0.004)
        rig.fault(channel, motor, kind, 0.0 if kind == "corrupt_rate" else False)

    return cause


GLITCHES = {f"{n} lost of {one}": fault("drop_next", n, one) for n in (1, 2) for one in (None, STEER, DRIVE, RAIL)}
GLITCHES |= {f"late by {ms} ms": fault("hold_back", {"seconds": 1e-3 * ms}) for ms in (5, 10)}
for one in (STEER, DRIVE, RAIL):
    for key, by in (("position_rad", 2.0), ("velocity_rad_s", 15.0), ("torque_nm", 9.0)):
        GLITCHES[f"{key} of {one}"] = fault("reading", {key: by, "answers": 1}, one)
    GLITCHES[f"garbled {one}"] = tick("corrupt_rate", 1.0, one, all_bytes=True)
for names in (("upper",), ("lower",), ("upper", "lower")):
    GLITCHES[f"{names} read as triggered"] = tick("switches", dict.fromkeys(names, True), channel="base_io")
GLITCHES |= {f"frozen {ms} ms": lambda rig, base, ms=ms: rig.sleep(1e-3 * ms) for ms in (20, 50, 100)}  # its loop
GLITCHES |= {f"cable of {channel}": tick("cable_out", True, channel=channel) for channel in ("base", "base_io")}
CASES = [(name, twist, way) for twist, way in ((TWIST, 1), (TURNED, 1), (TWIST, -1)) for name in GLITCHES]
QUICK = (f"2 lost of {RAIL}", "frozen 100 ms")


class Truth:
    """True velocities of the chassis, in its own frame, and of the carriage, from now on."""

    def __init__(self, rail):
        self._rig, self._world, self._rows = rail.rig, rail.world, []
        self._at = [self._world.model.joint(name).dofadr[0] for name in ("base", "base/rail")]
        rail.rig.device.each_advance.append(self._look)

    def _look(self):
        (chassis, carriage), qvel = self._at, self._world.data.qvel
        w, _, _, z = self._world.data.joint("base").qpos[3:]
        twist = to_body(qvel[[chassis, chassis + 1, chassis + 5]], 2.0 * math.atan2(z, w))
        self._rows.append((self._rig.now(), *twist, qvel[carriage]))

    def accelerations(self):
        """Largest mean accelerations over 20 ms, (4,): what is shorter is slack and slip."""
        rows = np.array(self._rows)
        spans = ((rows[:, 0] - rows[0, 0]) / 0.02).astype(int)
        mean = np.array([rows[spans == span, 1:].mean(axis=0) for span in range(spans[-1])])
        return np.abs(np.diff(mean, axis=0)).max(axis=0) / 0.02


def drift(rail, base):
    return base.odometry().pose - rail.rig.state()["base"]["pose"]


def drive(base, twist, lift, seconds):
    for _ in range(round(seconds / 0.02)):
        base.set_target_velocity(twist)
        base.set_rail_velocity(lift)
        base.clock.sleep(0.02)


@pytest.mark.parametrize("name, twist, way", spread(CASES, *(list(GLITCHES).index(name) for name in QUICK)))
def test_base_and_rail_do_not_feel_it(tmp_path, name, twist, way):
    rail = Rail(tmp_path, 0.5 - 0.3 * way)
    with contextlib.closing(rail.rig), rail.base() as base:
        drive(base, TWIST, LIFT_M_S * way, 1.0)
        truth = Truth(rail)
        away = drift(rail, base)
        base.set_target_velocity(twist)
        GLITCHES[name](rail.rig, base)
        drive(base, twist, LIFT_M_S * way, 0.5)
        assert base.observe().mode is Mode.TRACK
        assert (truth.accelerations() <= MOST[twist]).all()
        assert base.rail_state().velocity_m_s == pytest.approx(LIFT_M_S * way, abs=0.02)
        assert drift(rail, base) == pytest.approx(away, abs=0.02)  # a turn slips
        assert base.rail_state().height_m == pytest.approx(rail.height_m, abs=0.005)


@pytest.mark.long
def test_answers_held_back_for_longer_stop_the_rail_and_it_goes_on(tmp_path):
    rail = Rail(tmp_path)
    with contextlib.closing(rail.rig), rail.base() as base:
        drive(base, TWIST, LIFT_M_S, 0.8)
        rail.watch_fall()
        rail.rig.fault("base", None, "hold_back", {"seconds": 0.03})
        base.clock.sleep(0.026)
        assert rail.board.brake_on
        drive(base, TWIST, LIFT_M_S, 1.2)
        assert base.rail_state().velocity_m_s == pytest.approx(LIFT_M_S, abs=0.02)
        assert base.observe().trouble is None and rail.fallen_m < MOST_FALL_M


@pytest.mark.parametrize("switch", ["upper", pytest.param("lower", marks=pytest.mark.long)])
def test_homing_believes_no_single_reading_of_a_switch(tmp_path, switch):
    rail = Rail(tmp_path, 0.1, stroke_m=0.25, known=False)
    with contextlib.closing(rail.rig), rail.base() as base:
        base._client.request(BaseRequest.HOME_RAIL)
        base.clock.sleep(0.5)
        tick("switches", {switch: True}, channel="base_io")(rail.rig, base)
        while base.rail_state().homing:
            base.clock.sleep(0.05)
        assert base.rail_state().homed and base.rail_state().height_m == pytest.approx(rail.height_m, abs=3e-3)
