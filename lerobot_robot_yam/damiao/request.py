"""One request to the motors of a chain: whose answers are still to come."""

import math
from collections.abc import Iterable


class Request:
    """Answers that are still to come.

    Attributes:
        motors: by index, those that have not answered.
        handle: whether the handle was asked and has not answered.
        sent_s: when it had been sent (the chain's clock).

    Args:
        motors: by index, those that are asked.
        handle: whether the handle is.
        patient: whether it is waited for, too.
    """

    def __init__(self, motors: Iterable[int], handle: bool, patient: bool):
        self.motors = set(motors)
        self.handle = handle
        self.sent_s = -math.inf
        self._patient = patient

    @property
    def missing(self) -> int:
        """How many answers are waited for."""
        return len(self.motors) + (self.handle and self._patient)
