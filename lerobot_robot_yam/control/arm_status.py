"""The status of one arm: its mode, its trouble, and the orders that stand. The mode is written here only."""

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import TRANSITIONS, Mode
from lerobot_robot_yam.state.records import Limited


class ArmStatus:
    """Status of the arm called `name`.

    Args:
        name: for messages.
        floats: the arm floats, rather than holds, unless something else is asked of it: a leader.

    Attributes:
        trouble, message: why it is in FAULT, or lands.
        limited: what keeps it from doing what it is told.
        stopped: the emergency stop is latched. The loop says so before anything is asked or decided.
        must_land: it lands as soon as the emergency stop is released.
        halted: it takes no targets until it is re-armed, because the other arm is in trouble.
        stops_afloat: during the emergency stop that is latched it floats, rather than holds.
        rearming: its motors are being re-armed; a landing waits for that.
        letting_go: its torque is being cut.
        refusal: why what was requested last was not done; else empty.
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
        """Whether what was requested last takes more ticks; nothing else is requested meanwhile."""
        return self.rearming or self.letting_go

    @property
    def afloat(self) -> bool:
        """Whether only the model carries it."""
        return self._mode is Mode.FLOAT or (self._mode is Mode.STOPPED and self.stops_afloat)

    def check(self, mode: Mode) -> None:
        """Raises LifeCycleError: the table of transitions does not lead from the present mode to this one."""
        if mode not in TRANSITIONS[self._mode]:
            possible = ", ".join(sorted(mode.name.lower() for mode in TRANSITIONS[self._mode])) or "nothing"
            way = f"{self._mode.name.lower()} to {mode.name.lower()}"
            raise LifeCycleError(f"{self.name}: cannot go from {way}; possible from here: {possible}")

    def enter(self, mode: Mode) -> None:
        """Change the mode. Raises LifeCycleError: see `check`."""
        self.check(mode)
        self._mode = mode
