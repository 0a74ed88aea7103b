"""Calibration of a gamepad: a person moves each stick to both ends, and presses the button of each use."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.pad_map import FRAME, OVERRIDE, RESET, SLOW, STOP, AxisUse, PadMap
from lerobot_robot_yam.face.driving.sdl_pads import Reading

RATE_HZ = 50.0  # readings per second
_STILL = 0.05  # maximum motion of an axis while the sticks are let go
_STILL_S = 2.0  # duration of rest that is averaged, s
_PUSHED, _BACK = 0.5, 0.2  # distances from rest at which an axis counts as pushed, and as let go again
_STEP_S = 30.0  # timeout of each step, s

_WAYS = {
    "x": ("forward", "backward"),
    "y": ("to the left", "to the right"),
    "theta": ("to the left in place", "to the right in place"),
    "height": ("up", "down"),
}
_VERBS = {"x": "drive", "y": "drive", "theta": "turn", "height": "move the rail"}
_BUTTONS = {
    STOP: "is the emergency stop",
    FRAME: "switches between local and global frame",
    RESET: "resets the odometry",
    SLOW: "makes the base slow while it is held",
    OVERRIDE: "takes over from a policy while it is held",
}


def record_map(readings: Iterator[Reading], tell: Callable[[str], None], rail: bool) -> PadMap:
    """Ask for each stick and button in turn, and return the map.

    Args:
        readings: `RATE_HZ` readings per second.
        tell: function that shows a request to the person.
        rail: whether a stick moves a rail.

    Raises:
        ConfigError: the person did nothing for 30 s, or moved another axis; nothing is stored.
    """
    tell("let go of all sticks")
    rest = _rest(readings)
    axes: dict[str, AxisUse] = {}
    for name in _WAYS if rail else list(_WAYS)[:3]:
        ends: list[float] = []
        number = -1
        for way in _WAYS[name]:
            tell(f"push the stick that shall {_VERBS[name]} {way} to its end, and let it go")
            taken = [use.axis for use in axes.values()]
            axis, end = _pushed(readings, rest, taken, f"{_VERBS[name]} {way}")
            if ends and (axis != number or (end - rest[axis]) * (ends[0] - rest[axis]) > 0.0):
                raise ConfigError(f"{_VERBS[name]} {way}: that was not the other end of axis {number}; calibrate again")
            number = axis
            ends.append(end)
        axes[name] = AxisUse(number, rest[number], *ends)
    return PadMap(axes, _buttons(readings, tell))


def _steps(readings: Iterator[Reading], what: str) -> Iterator[Reading]:
    """Yield readings for 30 s. Raises ConfigError: the time is over."""
    for _ in range(round(_STEP_S * RATE_HZ)):
        yield next(readings)
    raise ConfigError(f"{what}: nothing came for {_STEP_S:.0f} s; nothing was stored, calibrate again")


def _rest(readings: Iterator[Reading]) -> list[float]:
    still: list[Sequence[float]] = []
    for reading in _steps(readings, "let go of all sticks"):
        if still and max(abs(a - b) for a, b in zip(reading.axes, still[0], strict=True)) > _STILL:
            still.clear()
        still.append(reading.axes)
        if len(still) >= _STILL_S * RATE_HZ:
            break
    return [sum(column) / len(still) for column in zip(*still, strict=True)]


def _pushed(readings: Iterator[Reading], rest: Sequence[float], taken: Sequence[int], what: str) -> tuple[int, float]:
    """Return the axis that is pushed and let go again, and its end. An axis in `taken` does not count."""
    axis, end = -1, 0.0
    for reading in _steps(readings, what):
        offsets = [0.0 if n in taken else abs(value - rest[n]) for n, value in enumerate(reading.axes)]
        if axis < 0 and max(offsets) > _PUSHED:
            axis = offsets.index(max(offsets))
            end = reading.axes[axis]
        elif axis >= 0:
            if offsets[axis] > abs(end - rest[axis]):
                end = reading.axes[axis]
            if offsets[axis] < _BACK:
                break
    return axis, end


def _buttons(readings: Iterator[Reading], tell: Callable[[str], None]) -> Mapping[str, int]:
    """Return use → button. The stop button a second time leaves a use without a button."""
    found: dict[str, int] = {}
    for use, words in _BUTTONS.items():
        tell(f"press the button that {words}" + (" (the stop button: none)" if found else ""))
        before: tuple[bool, ...] | None = None
        for reading in _steps(readings, f"the button that {words}"):
            down = [n for n, now in enumerate(reading.buttons) if before is not None and now and not before[n]]
            before = reading.buttons
            if down and (not found or down[0] == found[STOP] or down[0] not in found.values()):
                if not found or down[0] != found[STOP]:
                    found[use] = down[0]
                break
    return found
