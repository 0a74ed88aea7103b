"""Right to control the arms. No browser has it until a person has confirmed; then one browser at a time.

    watching ──connect──▶ connecting ──arms hold──▶ enabled ──take──▶ control
        ▲                                              ▲  ◀──give, lost──┘
        └──────────────── landed ──────────────────────┘

A browser is identified by its connection number. A browser that reconnects gets a new number.
"""

from enum import Enum

from lerobot_robot_yam.errors import LifeCycleError


class Stage(Enum):
    """Stage of the page."""

    WATCHING = "watching"  # this page has energised no arm
    CONNECTING = "connecting"
    ENABLED = "enabled"  # the arms hold, and no browser controls them
    CONTROL = "control"


_REFUSED = {
    Stage.WATCHING: "the arms are not connected: press `connect …` and confirm it",
    Stage.CONNECTING: "the arms are being connected: wait",
    Stage.ENABLED: "nobody controls the arms: press `take control`",
}


class ControlDesk:
    """Stage of the page, and the browser that has control. Only one thread may change this object.

    Attributes:
        holder: browser that controls the arms, or None.
        asker: browser that requests control from the holder, or None.
    """

    def __init__(self) -> None:
        self.stage = Stage.WATCHING
        self.holder: int | None = None
        self.asker: int | None = None

    def begin(self) -> None:
        """Start connecting, after a person has confirmed. Raises LifeCycleError: already connected or connecting."""
        if self.stage is not Stage.WATCHING:
            raise LifeCycleError("the arms are connected already")
        self.stage = Stage.CONNECTING

    def enable(self) -> None:
        """Enter the stage ENABLED: the arms hold."""
        self.stage = Stage.ENABLED

    def end(self) -> None:
        """Return to the stage WATCHING, after the arms have landed or failed to start."""
        self.stage, self.holder, self.asker = Stage.WATCHING, None, None

    def take(self, browser: int) -> bool:
        """Give control to the browser and return True, if no other browser has control.

        Otherwise record the browser's request and return False.

        Raises:
            LifeCycleError: the arms are not connected.
        """
        if self.stage in (Stage.WATCHING, Stage.CONNECTING):
            raise LifeCycleError(_REFUSED[self.stage])
        if self.holder not in (None, browser):
            self.asker = browser
            return False
        self._hand_to(browser)
        return True

    def give(self, browser: int) -> int | None:
        """Pass control to the browser that has requested it, or to no browser; return the new holder.

        Raises:
            LifeCycleError: the browser that calls this does not have control.
        """
        self.check(browser)
        self._hand_to(self.asker)
        return self.holder

    def lost(self, browser: int) -> bool:
        """Remove a disconnected browser; return whether that browser had control."""
        if self.asker == browser:
            self.asker = None
        if self.holder != browser:
            return False
        self._hand_to(None)
        return True

    def check(self, browser: int) -> None:
        """Raise LifeCycleError, with reason and remedy, if the browser may not command the arms."""
        if self.stage is not Stage.CONTROL:
            raise LifeCycleError(f"nothing was done: {_REFUSED[self.stage]}")
        if browser != self.holder:
            raise LifeCycleError(f"nothing was done: browser {self.holder} controls the arms; press `take control`")

    def is_free_for(self, browser: int) -> bool:
        """Return whether no other browser controls the arms."""
        return self.holder in (None, browser)

    def check_unheld(self, browser: int) -> None:
        """Raise LifeCycleError if another browser controls the arms."""
        if not self.is_free_for(browser):
            self.check(browser)

    def _hand_to(self, browser: int | None) -> None:
        self.holder = browser
        self.stage = Stage.ENABLED if browser is None else Stage.CONTROL
        if browser is None or self.asker == browser:
            self.asker = None
