"""Comparison of each motor's reported torque with the torque that its commands give at its reported position.

    |tau − kp (q* − q) − kd (dq* − dq) − tau*|  ≤  0.15 range (1 + |dq| / 2 rad/s)

A position that drifts together with its speed contradicts nothing else: the motor goes on holding the joint, with
little torque, where the reading asks for much. A joint that a hand pushes away pulls back with the torque it reports.
A motor that works hard in the direction asked is believed, since many end below the range of their frames.
"""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.system.few_values import any_of

SHARE = 0.15
"""Tolerated difference between reported and commanded torque, as a share of the motor's range."""
_SPEED_RAD_S = 2.0  # speed at which twice the difference is tolerated, rad/s: voltage limits the torque of quick motors
_HARD = 0.6  # share of its range that counts as hard: a DM4310 ends at 7 of 10 Nm
_COMMANDS = 16  # number of commands of which a reply may show the torque: 64 ms, more than a slow adapter takes
_TICKS = 6  # consecutive contradictions after which a motor is not believed


class TorqueCheck:
    """Comparison for n motors. Call `sent` and `lying` once per tick.

    Args:
        range_nm: (n,) maximum torques of the motors.
    """

    def __init__(self, range_nm: np.ndarray):
        self._range = range_nm
        self._commands = np.zeros((_COMMANDS, len(range_nm), 5))
        self._next = 0
        self._stamp_s: np.ndarray = np.zeros(len(range_nm))
        self._times: np.ndarray = np.zeros(len(range_nm), dtype=int)  # consecutive contradictions
        self._none: list[int] = []

    def sent(self, commands: np.ndarray) -> None:
        """Record commands (n, 5), in joint coordinates, that have been sent."""
        self._commands[self._next] = commands
        self._next = (self._next + 1) % _COMMANDS

    def lying(
        self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray, stamp_s: np.ndarray, usable: np.ndarray
    ) -> Sequence[int]:
        """Return the motors whose readings (n,) have contradicted their torques for some ticks.

        Motors that are not `usable` (n,), or have not replied since the last call, contradict nothing.
        """
        fresh, self._stamp_s = stamp_s != self._stamp_s, stamp_s
        most = SHARE * self._range * (1.0 + np.abs(dq) / _SPEED_RAD_S)
        off = np.abs(mit_laws.motor_torque(self._commands[self._next - 1], q, dq) - tau) > most
        if not any_of(off):  # the usual case
            if any_of(self._times):
                self._times[:] = 0
            return self._none
        gives = np.clip(mit_laws.motor_torque(self._commands, q, dq), -self._range, self._range)
        off = ((tau < gives.min(axis=0) - most) | (tau > gives.max(axis=0) + most)) & fresh & usable
        hard = np.where(tau > 0.0, gives.max(axis=0), -gives.min(axis=0)) > 0.0
        off &= ~(hard & (np.abs(tau) > _HARD * self._range))
        self._times = np.where(off, self._times + 1, 0)
        return np.flatnonzero(self._times >= _TICKS).tolist()
