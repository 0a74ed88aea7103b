"""Clock of a bus: the computer's, or that of a world that is simulated tick by tick.

Drivers and loops read the time and wait through the clock of their bus. So the same code runs on real hardware and in
lock-step with a simulation (`rig.lockstep`), where time stands still while the caller computes.
"""

import time
from typing import Any, Protocol

START_TIMEOUT_S = 60.0  # longest wait for a new process, s: it may start a virtual rig, or calibrate a gripper


class Clock(Protocol):
    """Monotonic clock, s, that can also wait."""

    def now(self) -> float: ...

    def sleep(self, seconds: float) -> None:
        """Wait; negative seconds are an error, as for `time.sleep`."""


class SystemClock:
    """Clock of the computer."""

    now = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)


SYSTEM = SystemClock()


def clock_of(bus: Any) -> Clock:
    """Return the clock of a CAN bus: its attribute `clock`, else the computer's."""
    clock: Clock = getattr(bus, "clock", SYSTEM)
    return clock
