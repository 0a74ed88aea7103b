"""State of one arm: mode, fault (`Trouble`) and pending requests. No other module changes the mode."""

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import TRANSITIONS, Mode
from lerobot_robot_yam.state.records import Limited


class ArmStatus:
    """Status of the arm called `name`.

    Args:
        name: name of the arm, for messages.
        floats: whether the arm floats by default, like a leader; else the arm holds by default.

    Attributes:
        trouble, message: fault and text that explain why the arm is in FAULT or lands.
        limited: limits that keep the arm from reaching its target.
        stopped: whether the emergency stop is latched; the loop sets this flag at each tick before `decide`.
        must_land: whether the arm lands as soon as the emergency stop is released.
        halted: whether the arm refuses targets until re-armed, because the other arm is in fault.
        stops_afloat: whether the arm floats during the latched emergency stop; else the arm holds.
        rearming: whether the arm's motors are being re-armed; a landing is delayed until re-arming ends.
        letting_go: whether the arm's motors are being disabled.
        refusal: reason why the last request was refused; empty if the request was accepted.
    """

    def __init__(self, name: str, floats: bool):
        self.name, self.floats = name, floats
        self._mode = Mode.OFFLINE
        self.trouble: Trouble | None = None
        self.message = ""
        self.limited = Limited.NOTHING
        self.stopped = self.must_land = self.halted = self.stops_afloat = False
        self.rearming = self.letting_go = False
        self.refusal = ""

    @property
    def mode(self) -> Mode:
        """The present mode."""
        return self._mode

    @property
    def ended(self) -> bool:
        """Whether the arm has no torque: off, or never energised."""
        return self._mode in (Mode.OFF, Mode.OFFLINE)

    @property
    def busy(self) -> bool:
        """Whether the last request is still in progress; further requests are not accepted meanwhile."""
        return self.rearming or self.letting_go

    @property
    def afloat(self) -> bool:
        """Whether the arm floats, supported by gravity compensation alone."""
        return self._mode is Mode.FLOAT or (self._mode is Mode.STOPPED and self.stops_afloat)

    def check(self, mode: Mode) -> None:
        """Check a mode change. Raises LifeCycleError: the present mode has no transition to `mode`."""
        if mode not in TRANSITIONS[self._mode]:
            possible = ", ".join(sorted(mode.name.lower() for mode in TRANSITIONS[self._mode])) or "nothing"
            way = f"{self._mode.name.lower()} to {mode.name.lower()}"
            raise LifeCycleError(f"{self.name}: cannot go from {way}; possible from here: {possible}")

    def enter(self, mode: Mode) -> None:
        """Change the mode. Raises LifeCycleError: see `check`."""
        self.check(mode)
        self._mode = mode
