"""Gamepads that are plugged in, read with SDL (pygame-ce), without a window or a display.

SDL knows about 2,000 pads: it gives them all the axes and buttons of one layout, in the order of `AXES` and `BUTTONS`.
The axes and buttons of any other pad are numbered as its driver numbers them.
"""

import os
from typing import Any, NamedTuple, Protocol

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

AXES = ("leftx", "lefty", "rightx", "righty", "lefttrigger", "righttrigger")
BUTTONS = (
    *("a", "b", "x", "y", "back", "guide", "start", "leftstick", "rightstick"),
    *("leftshoulder", "rightshoulder", "dpup", "dpdown", "dpleft", "dpright"),
)
_FULL = 32767  # SDL's number for a full deflection
_ENVIRONMENT = {
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
    "SDL_VIDEODRIVER": "dummy",  # events need a video driver, and there may be no display
    "SDL_NO_SIGNAL_HANDLERS": "1",  # otherwise SDL catches SIGTERM, and the process would not end
}
_gone: set[int] = set()  # instance ids of removed pads; SDL never uses an id twice
_runs = False  # whether this module has started SDL
_open: "set[SdlPad]" = set()  # SDL runs while a pad is open


class Reading(NamedTuple):
    """Axes, −1 … 1, and buttons of a pad at one moment."""

    axes: tuple[float, ...]
    buttons: tuple[bool, ...]


class Pad(Protocol):
    """A gamepad.

    Attributes:
        name: the maker's name. guid: SDL's identifier of the model.
        known: whether axes and buttons are in the order of `AXES` and `BUTTONS`.
    """

    name: str
    guid: str
    known: bool

    def read(self) -> Reading | None:
        """Return axes and buttons now; None once the pad is unplugged."""

    def close(self) -> None:
        """Release the pad. Idempotent."""


def _pygame() -> tuple[Any, Any]:
    """Return pygame, and its module of controllers. Raises ConfigError: it is not installed."""
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    try:
        import pygame
        from pygame._sdl2 import controller
    except ImportError as error:
        raise ConfigError(f"gamepads are read with pygame-ce, which is missing; {install_extra('gamepad')}") from error
    return pygame, controller


def _start() -> None:
    """Start SDL. Idempotent."""
    global _runs
    pygame, controller = _pygame()
    _runs = True
    pygame.display.init()
    controller.init()  # also starts SDL's joysticks, which pygame.joystick.init then finds running
    pygame.joystick.init()


def _stop() -> None:
    """Stop SDL, which has sockets and files, once no pad is open."""
    global _runs
    if _runs and not _open:
        _runs = False
        pygame, controller = _pygame()
        controller.quit()
        pygame.display.quit()


def _pump() -> None:
    """Let SDL read all pads, and note which were removed."""
    pygame, _ = _pygame()
    _gone.update(event.instance_id for event in pygame.event.get(pygame.JOYDEVICEREMOVED))
    pygame.event.clear(pump=False)


class SdlPad:
    """Pad that SDL reads, see `Pad`. index: SDL's number of the device at present."""

    def __init__(self, index: int):
        pygame, controller = _pygame()
        self._joystick = pygame.joystick.Joystick(index)
        self.name, self.guid = self._joystick.get_name(), self._joystick.get_guid()
        self.known = bool(controller.is_controller(index))
        self._controller = controller.Controller(index) if self.known else None
        self._instance = self._joystick.get_instance_id()
        _open.add(self)

    def read(self) -> Reading | None:
        _pump()
        if self._instance in _gone:
            return None
        if self._controller is not None:
            axes = [self._controller.get_axis(number) / _FULL for number in range(len(AXES))]
            buttons = [self._controller.get_button(number) for number in range(len(BUTTONS))]
        else:
            axes = [self._joystick.get_axis(number) for number in range(self._joystick.get_numaxes())]
            buttons = [self._joystick.get_button(number) for number in range(self._joystick.get_numbuttons())]
        return Reading(tuple(max(-1.0, axis) for axis in axes), tuple(map(bool, buttons)))

    def close(self) -> None:
        if self not in _open:
            return
        if self._controller is not None:
            self._controller.quit()
        self._joystick.quit()
        _open.remove(self)
        _stop()


def open_pad(device: str, wanted: str | None) -> SdlPad:
    """Open the pad that a device shall read, and no other.

    Args:
        device: LeRobot's type name, for messages.
        wanted: GUID, or a part of the name; None: the only pad.

    Raises:
        ConfigError: pygame-ce is not installed; there is no such pad, or more than one. The message lists the pads.
    """
    pygame, _ = _pygame()
    _start()
    _pump()
    pads = [SdlPad(index) for index in range(pygame.joystick.get_count())]
    fitting = [pad for pad in pads if wanted is None or wanted == pad.guid or wanted.lower() in pad.name.lower()]
    for pad in pads:
        if len(fitting) != 1 or pad is not fitting[0]:
            pad.close()
    if len(fitting) == 1:
        return fitting[0]
    _stop()
    listed = "".join(f"\n  {pad.name}: --teleop.pad={pad.guid}" for pad in (fitting or pads))
    if not pads:
        raise ConfigError(
            f"{device}: no gamepad is plugged in, or you may not read it (ls -l /dev/input; your user needs the group "
            "input, or a seat)"
        )
    if not fitting:
        raise ConfigError(f"{device}: no gamepad is called {wanted!r}; there are:{listed}")
    if len({pad.guid for pad in fitting}) < len(fitting):
        raise ConfigError(f"{device}: there are {len(fitting)} gamepads of one model; unplug all but one:{listed}")
    raise ConfigError(f"{device}: there are {len(fitting)} gamepads; say which:{listed}")
