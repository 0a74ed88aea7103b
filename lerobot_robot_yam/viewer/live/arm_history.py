"""The last seconds of one arm, sampled whenever the page reads its state."""

import math

import numpy as np

from lerobot_robot_yam.state.records import ArmState

SPAN_S = 10.0
_ROWS = 512  # of a ring; more than a page reads in that time


class ArmHistory:
    """A ring of samples of one arm with n motors, its joints in rad and then the gripper, 0 … 1.

    Columns: n each of q, set-point, target and torque (Nm), then the loop's period and the age of its samples, ms.
    """

    def __init__(self, motors: int):
        self._n = motors
        self._times = np.zeros(_ROWS)
        self._values = np.zeros((_ROWS, 4 * motors + 2))
        self._count = 0
        self._last: ArmState | None = None

    def add(self, state: ArmState) -> None:
        """Take a state, unless it is the one before or lacks a reading."""
        last, self._last = self._last, state
        if last is None or state.tick <= last.tick:
            return
        setpoint = state.setpoints
        action = state.action or ()
        target = action if len(action) == self._n else setpoint  # a leader's is for its follower, which has a gripper
        grip = state.gripper_tau_nm
        row = [*state.positions, *setpoint, *target, *state.tau_nm, *([] if grip is None else [grip])]
        row.append(1e3 * (state.published_s - last.published_s) / (state.tick - last.tick))
        row.append(1e3 * (state.published_s - state.stamp_s))
        if all(map(math.isfinite, row)):
            index = self._count % _ROWS
            self._times[index], self._values[index] = state.published_s, row
            self._count += 1

    def columns(self, now_s: float, *numbers: int) -> tuple[np.ndarray, ...]:
        """Seconds before now, (k,) from -10 to 0, and the values of some columns, (k,) each, oldest first."""
        kept = min(self._count, _ROWS)
        rows = np.arange(self._count - kept, self._count) % _ROWS
        rows = rows[self._times[rows] > now_s - SPAN_S]
        return self._times[rows] - now_s, *(self._values[rows, number] for number in numbers)
