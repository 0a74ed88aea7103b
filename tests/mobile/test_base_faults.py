"""Faults of the table in `scripts.soak.injected_faults`, on the motors and the channel of a base, in lock-step.

Each is noticed and named, the base comes to rest, takes no targets, and drives again once the cause is gone.
"""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.faults import RESPONSES, Response
from lerobot_robot_yam.state.modes import Mode
from scripts.soak.injected_faults import LEFT, MATRIX

STEER, DRIVE = "front_left_steer", "rear_right_drive"
DRIVEN_M_S, REST_M_S = 0.4, 0.01
NOT_OF_A_BASE = {
    "wrong-id",  # after the start it is a silent motor
    "turn",  # the wheels turn without end: a miscounted turn of one is no fault
}  # fmt: skip
ROWS = {name: row for name, row in MATRIX.items() if row.channel == LEFT and name not in NOT_OF_A_BASE}
QUICK = [
    ("motor-silent", STEER, "land"),
    ("leap", STEER, "track"),
    ("link-down", None, "track"),
    ("hot", DRIVE, "track"),
]


def every_case():
    for name, row in ROWS.items():
        for phase in filter(row.phases.__contains__, ("hold", "track", "land")):
            for motor in (None,) if row.motor is None else (STEER, DRIVE):
                yield name, motor, phase


@pytest.mark.long
@pytest.mark.parametrize("name, motor, phase", list(every_case()))
def test_every_fault_in_every_phase(name, motor, phase):
    check(name, motor, phase)


@pytest.mark.parametrize("name, motor, phase", QUICK)
def test_fault(name, motor, phase):
    check(name, motor, phase)


def check(name, motor, phase):
    fault = replace(ROWS[name], channel="base", motor=motor)
    rule = RESPONSES[fault.trouble]
    with contextlib.closing(LockstepRig("mobile")) as rig, contextlib.closing(made(rig)) as base:
        base.connect()
        if phase != "hold":
            drive(base, 3.0)
        fault.inject(rig)
        if phase == "land":
            base.close()
            assert not any(enabled(rig)) or fault.kind == "silent"  # a motor that hears nothing keeps its last command
            assert rule.arm is Response.LOST or speed(rig, rig) < REST_M_S
            return
        if phase == "track":
            drive(base, 2.0, force=True)
        else:
            base.clock.sleep(2.0)
        if rule.arm is Response.GO_ON:
            assert base.observe().trouble is None and base.observe().mode in (Mode.HOLD, Mode.TRACK)
            return
        found = base._session.base("base").published()
        assert (found.mode, found.trouble) == (Mode.FAULT, fault.trouble)
        assert motor is None or motor in found.message
        with pytest.raises(YamError):
            base.set_target_velocity([0.1, 0.0, 0.0])
        if rule.arm is Response.LOST:  # no command reaches the motors: their watchdogs have cut the torque
            assert not any(enabled(rig))
            return
        assert speed(rig, base.clock) < REST_M_S
        if motor is not None:
            assert sum(enabled(rig)) >= 7  # the others hold
        rig.clear_faults("base")
        if not rule.in_place:
            with pytest.raises(YamError):
                base.rearm()
            return
        base.rearm()
        drive(base, 3.0)
        assert speed(rig, base.clock) > 0.9 * DRIVEN_M_S


def made(rig):
    return YamBase(channel="base", interface="yam_lockstep", can_options={"rig": rig.name}, isolation="lockstep")


def drive(base, seconds, force=False):
    """Write targets at 20 Hz for some seconds; `force`: go on when they are refused."""
    for _ in range(round(seconds / 0.05)):
        with contextlib.suppress(*([YamError] if force else [])):
            base.set_target_velocity([DRIVEN_M_S, 0.0, 0.0])
        base.clock.sleep(0.05)


def speed(rig, clock):
    """Return the true speed, m/s, over the next 0.1 s."""
    before = np.array(rig.state()["base"]["pose"][:2])
    clock.sleep(0.1)
    return float(np.linalg.norm(np.array(rig.state()["base"]["pose"][:2]) - before)) / 0.1


def enabled(rig):
    return [motor["enabled"] for motor in rig.state()["base"]["motors"].values()]
