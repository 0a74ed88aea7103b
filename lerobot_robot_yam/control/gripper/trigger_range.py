"""Range of a handle's trigger: calibrated once (lerobot-calibrate) and stored in a file; nominal by default."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from lerobot_robot_yam.errors import GripperError
from lerobot_robot_yam.system.paths import write_whole

_FILE_VERSION = 1
_LEAST = 0.4  # minimum range of a squeezed trigger, as a share of the nominal travel
_MARGIN = 0.02  # share of the range cut off at each end: springs and fingers do not return exactly


class TriggerRange(NamedTuple):
    """Positions of the released and the squeezed trigger, as shares of the nominal travel."""

    released: float = 0.0
    squeezed: float = 1.0

    def share(self, travelled: float) -> float:
        """Convert a share of the nominal travel to the position, 0 released … 1 squeezed."""
        return min(max((travelled - self.released) / (self.squeezed - self.released), 0.0), 1.0)


def learn(arm: str, travelled: Sequence[float]) -> TriggerRange:
    """Compute the range from samples (shares of the nominal travel) taken while the trigger was squeezed and released.

    Raises:
        GripperError: the trigger has moved too little.
    """
    known = sorted(value for value in travelled if math.isfinite(value))
    low, high = (known[0], known[-1]) if known else (0.0, 0.0)
    if high - low < _LEAST:
        raise GripperError(
            f"{arm}: the trigger has moved by {100 * (high - low):.0f} % of its travel; squeeze it fully and let go "
            "while it is being calibrated"
        )
    margin = _MARGIN * (high - low)
    return TriggerRange(low + margin, high - margin)


def load_range(arm: str, path: Path, gripper: str) -> TriggerRange:
    """Load the stored range; return the nominal range if there is no file.

    Raises:
        GripperError: the file is unreadable, damaged, or for another gripper.
    """
    try:
        data = json.loads(path.read_text())
        found = TriggerRange(float(data["released"]), float(data["squeezed"]))
        if data["gripper"] != gripper or data["version"] != _FILE_VERSION:
            raise ValueError(f"made for {data['gripper']!r}, file version {data['version']}")
        if not (0.0 <= found.released and found.squeezed <= 1.0 and found.squeezed - found.released >= _LEAST / 2):
            raise ValueError("no range of a trigger")
    except FileNotFoundError:
        return TriggerRange()
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise GripperError(
            f"{arm}: {path} is no range of a trigger ({error}); delete it and calibrate again (lerobot-calibrate)"
        ) from error
    return found


def save_range(arm: str, path: Path, gripper: str, travel: TriggerRange) -> None:
    """Write the range atomically. Raises GripperError: the file cannot be written."""
    data = {"version": _FILE_VERSION, "gripper": gripper, **travel._asdict()}
    try:
        write_whole(path, json.dumps(data, indent=1) + "\n")
    except OSError as error:
        raise GripperError(
            f"{arm}: the trigger's range cannot be stored in {path} ({error}); correct `calibration_path` or its "
            "permissions, then calibrate again (lerobot-calibrate)"
        ) from error
