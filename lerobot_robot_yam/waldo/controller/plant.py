"""What the controller moves: the seam between its set-point and an arm, simulated or real."""

from typing import NamedTuple, Protocol

import numpy as np

JAW_ROUNDING = 0.03  # of the stroke: as near as a jaw comes to where it is asked to be


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
        return self.opening - self.asked_opening > JAW_ROUNDING


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
