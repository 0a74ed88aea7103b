"""Random false readings of one motor, with a joint simulated simply: what is believed of them moves nothing too far.

The chain of these parts is the loop's: plausibility check, torque check, torque clip. The servo knows its true state.
"""

import math
import random

import numpy as np
import pytest

from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.safety.torque_check import TorqueCheck
from lerobot_robot_yam.damiao.plausibility import Plausibility
from lerobot_robot_yam.damiao.tables import motor_type
from tests.support.tiers import spread

TICK_S, TICKS, STEPS = 0.004, 120, 4
LIMIT_RAD_S, MOST_SPEED = 1.5, 1.3
MOST_RAD = 0.08  # off the set-point: a heavy joint lags by 0.03 rad, and overshoots where the set-point stops at once
BEGIN = 20  # tick of the first false reading
ROWS = {
    "DM4310": (10.0, 1.5, 0.01),
    "DM4340": (80.0, 5.0, 0.2),
    "DM6248": (150.0, 5.0, 0.6),
    "DM3507": (10.0, 0.5, 0.003),
}
"""Motor type → kp, kd and the inertia of its load, kg m²."""


class Lie:
    """A drift, step, freeze, or scaling of position or speed, or several of them; `none`: a healthy motor."""

    def __init__(self, chance, healthy):
        kinds = (
            () if healthy else chance.sample(["drift", "step", "freeze", "scale", "speed"], chance.choice([1, 1, 2]))
        )
        self.kinds, sign = kinds, chance.choice([-1, 1])
        self._drift = sign * 10 ** chance.uniform(-3.5, -1.5) if "drift" in kinds else 0.0
        self._step = sign * 10 ** chance.uniform(-3.0, 1.0) if "step" in kinds else 0.0
        self._scale = (chance.uniform(0.0, 2.0), chance.uniform(0.0, 2.0)) if "scale" in kinds else (1.0, 1.0)
        self._speed = chance.uniform(-4.0, 4.0) if "speed" in kinds else 0.0
        if self._drift and chance.random() < 0.3:
            self._speed = self._drift / TICK_S
        self._frozen = None

    def told(self, q, dq):
        self._step += self._drift
        said = q * self._scale[0] + self._step, dq * self._scale[1] + self._speed
        if "freeze" in self.kinds:
            self._frozen = self._frozen or said
            return self._frozen
        return said


def quantised(value, most, bits):
    steps = 2**bits - 1
    code = math.floor((min(max(value, -most), most) + most) * steps / (2 * most))
    return code * 2 * most / steps - most


def run(kind, chance, healthy=False):
    """Farthest distance from the set-point, largest speed and torque as shares of their limits; whether believed."""
    row, (kp, kd, inertia) = motor_type(kind), ROWS[kind]
    clip = np.array([chance.uniform(0.3, 1.0) * row.torque_max_nm])
    judge, torques = Plausibility([row], [False]), TorqueCheck(np.array([row.torque_max_nm]))
    lie, start, reach, hz = (
        Lie(chance, healthy),
        chance.uniform(-1, 1),
        chance.choice([0.0, 0.3]),
        chance.uniform(0.2, 0.8),
    )
    q, dq, nm, believed = start, 0.0, 0.0, (start, 0.0)
    command, held, farthest, fastest, most = np.array([[start, 0.0, kp, kd, 0.0]]), None, 0.0, 0.0, 0.0
    for tick in range(TICKS):
        now = tick * TICK_S + chance.uniform(0.0, 0.0005)
        q_seen, dq_seen = (q, dq) if tick < BEGIN else lie.told(q, dq)
        seen = quantised(q_seen, row.position_max_rad, 16), quantised(dq_seen, row.velocity_max_rad_s, 12)
        if chance.random() > 0.02 and judge.accept(0, *seen, now + 0.0003, now + 0.0004, now, now + 0.001):
            believed = seen
        arrays = (np.array([believed[0]]), np.array([believed[1]]), np.array([nm]), np.array([now]), np.array([True]))
        if torques.lying(command, *arrays):
            judge.distrust([0])
        phase = 2 * math.pi * hz * (tick + 1) * TICK_S
        goal = start + reach * (1.0 - math.cos(phase)), reach * 2 * math.pi * hz * math.sin(phase)
        if judge.distrusted[0]:
            held = held or (command[0, mit_laws.Q], 0.0)
            goal = believed = held
        command = np.array([[*goal, kp, kd, 0.0]])
        mit_laws.clip_torque(command, np.array([believed[0]]), np.array([believed[1]]), clip)
        for _ in range(STEPS):
            nm = float(mit_laws.motor_torque(command, np.array([q]), np.array([dq]))[0])
            most = max(most, abs(nm) / clip[0])
            dq += nm / inertia * TICK_S / STEPS
            q += dq * TICK_S / STEPS
        farthest, fastest = max(farthest, abs(q - goal[0])), max(fastest, abs(dq))
    return farthest, fastest, most, not judge.distrusted[0], lie


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "kind, count", spread([*((kind, 25) for kind in ROWS), *((kind, 10_000) for kind in ROWS)], 0, 1)
)
def test_false_readings_throw_no_joint(kind, count):
    chance = random.Random(kind)
    for number in range(count):
        farthest, fastest, most, _, lie = run(kind, chance)
        what = f"{kind} number {number}: {vars(lie)}"
        assert most <= 1.01, what
        assert fastest <= MOST_SPEED * LIMIT_RAD_S, f"{what}: {fastest} rad/s"
        assert farthest <= MOST_RAD, f"{what}: {farthest} rad"


@pytest.mark.parametrize("kind", ROWS)
def test_a_healthy_joint_is_believed(kind):
    chance = random.Random(kind)
    assert all(run(kind, chance, healthy=True)[3] for _ in range(15))
