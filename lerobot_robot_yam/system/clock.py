"""Clock of a bus: the computer's clock, or that of a world simulated tick by tick.

Drivers and loops read the time and sleep on the clock of their bus. So the same code runs on real hardware and in
lock-step with a simulation (`rig.lockstep`), where time stands still while the caller computes.
"""

import time
from typing import Any, Protocol

START_TIMEOUT_S = 60.0  # timeout for the start of a process, s: it may start a virtual rig or calibrate a gripper


class Clock(Protocol):
    """Monotonic clock, s, that can also sleep."""

    def now(self) -> float: ...

    def sleep(self, seconds: float) -> None:
        """Sleep; negative seconds are an error, as for `time.sleep`."""


class SystemClock:
    """Clock of the computer."""

    now = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)


SYSTEM = SystemClock()


def clock_of(bus: Any) -> Clock:
    """Return the clock of a CAN bus: its attribute `clock`, else the computer's clock."""
    clock: Clock = getattr(bus, "clock", SYSTEM)
    return clock
