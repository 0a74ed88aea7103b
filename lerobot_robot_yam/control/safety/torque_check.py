"""Comparison of reported with commanded torques, for joints that read far from where they are sent.

    |q* − q| > 0.3 rad  and  |tau − kp (q* − q) − kd (dq* − dq) − tau*| > 0.15 range (1 + v / 2 rad/s)

v is the speed in the direction of the torque asked for, since voltage limits the torque of a quick motor. A position
that drifts together with its speed contradicts nothing else: the motor goes on holding the joint, with little torque,
where the reading asks for much. A joint that a hand or an obstacle keeps away pulls with the torque that it reports. A
motor that works hard in the direction asked is believed, since many end below the range of their frames.
"""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.system.few_values import any_of

SHARE = 0.15
"""Tolerated difference between reported and commanded torque, as a share of the motor's range."""
_AWAY_RAD = 0.3  # distance from its set-point that no joint reaches by lagging, as a late command or reply shows it
_SPEED_RAD_S = 2.0  # speed at which twice the difference is tolerated, rad/s
_HARD = 0.6  # share of its range that counts as hard: a DM4310 ends at 7 of 10 Nm
_TICKS = 6  # consecutive contradictions after which a motor is not believed


class TorqueCheck:
    """Comparison for n joints. Call `lying` once per tick.

    Args:
        range_nm: (n,) maximum torques of the motors.
    """

    def __init__(self, range_nm: np.ndarray):
        self._range = range_nm
        self._stamp_s: np.ndarray = np.zeros(len(range_nm))
        self._times: np.ndarray = np.zeros(len(range_nm), dtype=int)  # consecutive contradictions

    def lying(
        self, sent: np.ndarray, q: np.ndarray, dq: np.ndarray, tau: np.ndarray, stamp_s: np.ndarray, usable: np.ndarray
    ) -> Sequence[int]:
        """Return the joints whose readings have contradicted their torques for some ticks.

        Joints that are commanded no stiffness, are not `usable`, or have not replied since the last call, contradict
        nothing.

        Args:
            sent: (n, 5) last commands, in joint coordinates.
            q, dq, tau, stamp_s, usable: (n,) readings, the times of their samples, and whether they are used.
        """
        fresh, self._stamp_s = stamp_s != self._stamp_s, stamp_s
        away = (np.abs(sent[:, mit_laws.Q] - q) > _AWAY_RAD) & (sent[:, mit_laws.KP] > 0.0)
        if not any_of(away):  # the usual case
            self._times[:] = 0
            return ()
        asked = np.clip(mit_laws.motor_torque(sent, q, dq), -self._range, self._range)
        speed = np.maximum(dq * np.sign(asked), 0.0)
        off = np.abs(asked - tau) > SHARE * self._range * (1.0 + speed / _SPEED_RAD_S)
        off &= ~((asked * tau > 0.0) & (np.abs(tau) > _HARD * self._range))
        self._times = np.where(away & off & fresh & usable, self._times + 1, 0)
        return np.flatnonzero(self._times >= _TICKS).tolist()
