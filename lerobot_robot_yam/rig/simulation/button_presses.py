"""Presses of handle buttons: which are down, until when, and the events that tell of it."""

from collections.abc import Callable

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.bus.channel import Channel

BUTTONS = ("sync", "record")  # the top one, the second one


class ButtonPresses:
    """The thumb on the handles' buttons.

    Args:
        log: gets the channel, the button, and whether it is down now, at each edge.
    """

    def __init__(self, log: Callable[[str, str, bool], None]):
        self._log = log
        self._ends: dict[tuple[str, int], tuple[Channel, float]] = {}  # simulated times

    def press(self, channel: Channel, button: str, until_sim_s: float, now_s: float) -> None:
        """Hold a button down until a simulated time; a later end replaces an earlier one.

        Raises:
            ConfigError: no such button.
        """
        if button not in BUTTONS:
            raise ConfigError(f"a handle has the buttons {', '.join(BUTTONS)}, not {button!r}")
        index = BUTTONS.index(button)
        self._ends[channel.name, index] = channel, until_sim_s
        self._move(channel, index, True, now_s)

    def hold(self, channel: Channel, down: tuple[bool, bool], now_s: float) -> None:
        """Hold both buttons down, or not, from now on."""
        for index, one in enumerate(down):
            self._ends.pop((channel.name, index), None)
            self._move(channel, index, one, now_s)

    def advance(self, sim_s: float, now_s: float) -> None:
        """Let go of the buttons whose time has come."""
        for key, (channel, end_s) in list(self._ends.items()):
            if sim_s >= end_s:
                del self._ends[key]
                self._move(channel, key[1], False, now_s)

    def _move(self, channel: Channel, index: int, down: bool, now_s: float) -> None:
        handle = channel.handle
        assert handle is not None  # the caller has looked
        if handle.buttons[index] is down:
            return
        first, second = handle.buttons
        event = handle.press((down, second) if index == 0 else (first, down))
        self._log(channel.name, BUTTONS[index], down)
        if event is not None:
            channel.emit(event, now_s)
