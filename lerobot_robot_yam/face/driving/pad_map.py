"""Map of one model of gamepads: which axis drives what, its range and rest, and which button does what.

    deflection = (axis − rest) / (end − rest),  end: the axis at full deflection on that side

A map is stored per model of pads, by SDL's GUID.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.sdl_pads import AXES, BUTTONS, Pad, Reading
from lerobot_robot_yam.system.paths import write_whole

DIRECTIONS = ("x", "y", "theta", "height")  # forward, left, counter-clockwise, up
STOP, FRAME, RESET, SLOW, OVERRIDE = "stop", "frame", "reset", "slow", "override"
USES = (STOP, FRAME, RESET, SLOW, OVERRIDE)  # of buttons
CALIBRATE = "lerobot-calibrate --teleop.type=yam_gamepad"

_FILE_VERSION = 1
_LEAST_TRAVEL = 0.25  # minimum distance between rest and end of a usable axis


@dataclass(frozen=True)
class AxisUse:
    """Axis of a pad. positive, negative: its values at full deflection to the positive and negative side."""

    axis: int
    rest: float
    positive: float
    negative: float

    def deflection(self, value: float) -> float:
        """Return the deflection, −1 … 1."""
        offset = value - self.rest
        sign = 1.0 if offset * (self.positive - self.rest) > 0.0 else -1.0
        end = self.positive if sign > 0.0 else self.negative
        return sign * min(abs(offset) / abs(end - self.rest), 1.0)


@dataclass(frozen=True)
class PadMap:
    """Map of one model. axes: direction → axis. buttons: use → number of the button."""

    axes: Mapping[str, AxisUse]
    buttons: Mapping[str, int]

    def deflections(self, reading: Reading) -> dict[str, float]:
        """Return direction → deflection, −1 … 1, without dead zone."""
        return {name: use.deflection(reading.axes[use.axis]) for name, use in self.axes.items()}

    def pressed(self, reading: Reading) -> dict[str, bool]:
        """Return use → whether its button is down."""
        return {name: reading.buttons[number] for name, number in self.buttons.items()}

    def check(self, reading: Reading) -> None:
        """Check that the map fits a pad. Raises ValueError: it does not."""
        for name, use in self.axes.items():
            travels = (use.positive - use.rest, use.negative - use.rest)
            if not all(math.isfinite(travel) and abs(travel) >= _LEAST_TRAVEL for travel in travels):
                raise ValueError(f"the axis of {name} hardly moves")
            if travels[0] * travels[1] > 0.0:
                raise ValueError(f"the axis of {name} moves to one side only")
            if not 0 <= use.axis < len(reading.axes):
                raise ValueError(f"the pad has no axis {use.axis}")
        for number in self.buttons.values():
            if not 0 <= number < len(reading.buttons):
                raise ValueError(f"the pad has no button {number}")
        if STOP not in self.buttons or not {"x", "y", "theta"} <= self.axes.keys():
            raise ValueError("it is incomplete")

    def save(self, pad: Pad, path: Path) -> None:
        """Write the map. Raises ConfigError: the file cannot be written."""
        axes = {name: asdict(use) for name, use in self.axes.items()}
        data = {"version": _FILE_VERSION, "pad": pad.name, "axes": axes, "buttons": dict(self.buttons)}
        try:
            write_whole(path, json.dumps(data, indent=1) + "\n")
        except OSError as error:
            raise ConfigError(f"{pad.name}: the calibration cannot be stored in {path} ({error})") from error


def _usual() -> PadMap:
    """Return the map of the pads that SDL knows. Its sticks are +1 to the right and at the bottom."""
    sticks = {"x": "lefty", "y": "leftx", "theta": "rightx", "height": "righty"}
    axes = {name: AxisUse(AXES.index(stick), 0.0, -1.0, 1.0) for name, stick in sticks.items()}
    buttons = {STOP: "b", FRAME: "start", RESET: "back", SLOW: "leftshoulder", OVERRIDE: "rightshoulder"}
    return PadMap(axes, {use: BUTTONS.index(button) for use, button in buttons.items()})


def load_map(pad: Pad, path: Path) -> PadMap:
    """Return the map of a pad: the stored one, or the usual one.

    Raises:
        ConfigError: the file is unusable, or nothing is stored for a pad that SDL does not know.
    """
    reading = pad.read()
    if reading is None:
        raise ConfigError(f"{pad.name} was unplugged; plug it in")
    try:
        data = json.loads(path.read_text())
        if data["version"] != _FILE_VERSION:
            raise ValueError(f"it is of version {data['version']}")
        axes = {name: AxisUse(int(row.pop("axis")), **row) for name, row in data["axes"].items()}
        found = PadMap(axes, {str(use): int(number) for use, number in data["buttons"].items()})
        found.check(reading)
    except FileNotFoundError:
        if not pad.known:
            raise ConfigError(f"{pad.name}: SDL does not know which axis is which; calibrate it: {CALIBRATE}") from None
        return _usual()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{pad.name}: {path} is no calibration of this gamepad ({error}); delete it, or calibrate: {CALIBRATE}"
        ) from error
    return found
