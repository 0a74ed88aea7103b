"""Compensation for what packing loses.

MIT frames truncate: zero speed is sent as −half a step, which at kd = 1.5 Nm s/rad is 11 mNm and lets a wrist with
kp = 10 Nm/rad stand 1.1 mrad off. The loss of position and velocity is known, so the torque field can carry it:

    tau ← tau + kp (q* − q*_sent) + kd (dq* − dq*_sent) + half a torque step
"""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.damiao.tables import motor_type

_POSITION_STEPS = 2**16 - 1
_SHORT_STEPS = 2**12 - 1


class Quantiser:
    """Compensates commands of a row of motors, given by their types."""

    def __init__(self, types: Sequence[str]):
        rows = [motor_type(name) for name in types]
        self._limit = np.array([(row.position_max_rad, row.velocity_max_rad_s) for row in rows])
        self._step = 2.0 * self._limit / np.array([_POSITION_STEPS, _SHORT_STEPS])
        self._half_torque_step = np.array([row.torque_max_nm for row in rows]) / _SHORT_STEPS

    def compensate(self, commands: np.ndarray) -> np.ndarray:
        """(n, 5) q*, dq*, kp, kd, tau in motor coordinates to the same with a corrected tau (a copy)."""
        out = commands.copy()
        wanted = np.minimum(np.maximum(commands[:, :2], -self._limit), self._limit)
        sent = np.floor((wanted + self._limit) / self._step) * self._step - self._limit
        out[:, 4] += ((wanted - sent) * commands[:, 2:4]).sum(axis=1) + self._half_torque_step
        return out
