"""The status of one arm: its mode, its trouble, and the orders that stand. The mode is written here only."""

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import TRANSITIONS, Mode
from lerobot_robot_yam.state.records import Limited


class ArmStatus:
    """Status of the arm called `name`.

    Args:
        name: name of the arm, for messages.
        floats: whether the arm floats by default, as leaders do, rather than holds.

    Attributes:
        trouble, message: why the arm is in FAULT, or lands.
        limited: what keeps the arm from reaching its target.
        stopped: whether the emergency stop is latched; the loop sets this before each tick's decisions.
        must_land: whether the arm lands as soon as the emergency stop is released.
        halted: whether the arm refuses targets until it is re-armed, because the other arm is in trouble.
        stops_afloat: whether the arm floats, rather than holds, during the latched emergency stop.
        rearming: whether the arm's motors are being re-armed; a landing waits for that.
        letting_go: whether the arm's torque is being cut.
        refusal: why the last request was not done; else empty.
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
        """Whether the arm has no torque: it is off, or was never energised."""
        return self._mode in (Mode.OFF, Mode.OFFLINE)

    @property
    def busy(self) -> bool:
        """Whether the last request takes more ticks; no other one is accepted meanwhile."""
        return self.rearming or self.letting_go

    @property
    def afloat(self) -> bool:
        """Whether the arm floats, carried by its gravity model alone."""
        return self._mode is Mode.FLOAT or (self._mode is Mode.STOPPED and self.stops_afloat)

    def check(self, mode: Mode) -> None:
        """Check a change of mode. Raises LifeCycleError: no transition leads from the present mode to `mode`."""
        if mode not in TRANSITIONS[self._mode]:
            possible = ", ".join(sorted(mode.name.lower() for mode in TRANSITIONS[self._mode])) or "nothing"
            way = f"{self._mode.name.lower()} to {mode.name.lower()}"
            raise LifeCycleError(f"{self.name}: cannot go from {way}; possible from here: {possible}")

    def enter(self, mode: Mode) -> None:
        """Change the mode. Raises LifeCycleError: see `check`."""
        self.check(mode)
        self._mode = mode
