"""What the controller moves: the seam between its set-point and an arm, and the simulated arm behind it.

The real one is in `real_arm`.
"""

from typing import NamedTuple, Protocol

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm

_JAW_ROUNDING = 0.03  # of the stroke: as near as a jaw comes to where it is asked to be


class Reading(NamedTuple):
    """An arm at one moment. n joints; the gripper 0 closed … 1 open, None without one.

    Attributes:
        q, dq, tau_nm: (n,) measured; rad, rad/s, Nm.
        setpoint_q: (n,) rad, where the arm is asked to be.
        opening, asked_opening: the gripper, measured and asked for.
        jaw_still: it has arrived, or does not get farther.
        grip_nm: torque of its motor.
    """

    q: np.ndarray
    dq: np.ndarray
    tau_nm: np.ndarray
    setpoint_q: np.ndarray
    opening: float | None
    asked_opening: float | None
    jaw_still: bool
    grip_nm: float

    @property
    def holds_part(self) -> bool:
        """Whether something keeps the jaws from closing."""
        if self.opening is None or self.asked_opening is None or not self.jaw_still:
            return False
        return self.opening - self.asked_opening > _JAW_ROUNDING


class Plant(Protocol):
    """An arm that follows a set-point."""

    def read(self) -> Reading:
        """How it is. Raises YamError: it has failed or is silent."""

    def follow(self, q: np.ndarray, dq: np.ndarray, opening: float | None, dt_s: float) -> None:
        """Be at q (n,) rad, moving with dq (n,) rad/s, in this tick of dt_s.

        Raises:
            YamError: it takes no targets.
        """

    def rest(self) -> None:
        """No more set-points come for now: keep the last one. Raises YamError: it has failed."""


class SimulatedArm:
    """A plant that is where it is asked to be; its jaws move as fast as the gripper's motor may. No motor hears of it.

    Args:
        hardware: the arm.
        q: (n,) rad, where it is.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray):
        self._q, self._dq = np.array(q), np.zeros(len(q))
        self._jaw_speed = float(hardware.speed_limit[-1]) if hardware.has_gripper else 0.0
        self._opening = self._asked = 1.0 if hardware.has_gripper else None

    def read(self) -> Reading:
        still, zero = self._opening == self._asked, np.zeros(len(self._q))
        return Reading(self._q, self._dq, zero, self._q, self._opening, self._asked, still, 0.0)

    def follow(self, q: np.ndarray, dq: np.ndarray, opening: float | None, dt_s: float) -> None:
        self._q, self._dq = q, dq
        if self._opening is not None and opening is not None:
            most = self._jaw_speed * dt_s
            self._asked = opening
            self._opening += min(max(opening - self._opening, -most), most)

    def rest(self) -> None:
        self._dq = np.zeros(len(self._q))

    def teleport(self, q: np.ndarray, opening: float | None) -> None:
        """Be at q (n,) rad at once, and the jaws at `opening` if that is given."""
        self._q, self._dq = q, np.zeros(len(q))
        if self._opening is not None and opening is not None:
            self._opening = self._asked = opening
