"""The file that keeps the stops of a gripper from one session to the next."""

import contextlib
import json
import math
import time
from pathlib import Path

from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops
from lerobot_robot_yam.errors import GripperError
from lerobot_robot_yam.system.paths import write_whole

_FILE_VERSION = 1
_STORE_TIMEOUT_S = 2.0  # of a disk that other things write to


def load_stops(arm: str, path: Path, gripper: str) -> GripperStops | None:
    """Stored stops, or None when there is no file.

    Raises:
        GripperError: the file cannot be read, is damaged or belongs to another gripper.
    """
    try:
        data = json.loads(path.read_text())
        stops = GripperStops(float(data["closed_rad"]), float(data["open_rad"]))
        owner, version = data["gripper"], data["version"]
        if not math.isfinite(stops.closed_rad) or not math.isfinite(stops.open_rad):
            raise ValueError("stops are not finite")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise GripperError(
            f"{arm}: the gripper calibration {path} cannot be read ({error}); correct `calibration_path`, or "
            "the file's permissions"
        ) from error
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise GripperError(
            f"{arm}: {path} is not a gripper calibration ({error}); delete it and calibrate again (lerobot-calibrate)"
        ) from error
    if owner != gripper or version != _FILE_VERSION:
        raise GripperError(
            f"{arm}: {path} was made for gripper {owner!r} (file version {version}), not {gripper!r}; delete it"
        )
    return stops


def save_stops(arm: str, path: Path, gripper: str, stops: GripperStops) -> None:
    """Write the stops; a crash in the middle leaves the old file. Raises GripperError: it cannot be written."""
    data = {"version": _FILE_VERSION, "gripper": gripper, "closed_rad": stops.closed_rad, "open_rad": stops.open_rad}
    try:
        write_whole(path, json.dumps(data, indent=1) + "\n")
    except OSError as error:
        raise GripperError(
            f"{arm}: the gripper's stops cannot be stored in {path} ({error}); make room, or correct "
            "`calibration_path` or its permissions, then calibrate again (lerobot-calibrate)"
        ) from error


def await_stored(arm: str, path: Path, gripper: str, closed_rad: float, open_rad: float) -> None:
    """Wait until the control loop has stored the stops that it has found. The loop goes on when it cannot store them.

    Raises:
        GripperError: the file is not there after 2 s.
    """
    deadline = time.monotonic() + _STORE_TIMEOUT_S
    while True:
        last = time.monotonic() > deadline
        with contextlib.nullcontext() if last else contextlib.suppress(GripperError):  # the old file
            stored = load_stops(arm, path, gripper)
            if stored is not None and (stored.closed_rad, stored.open_rad) == (closed_rad, open_rad):
                return
        if last:
            raise GripperError(
                f"{arm}: nothing was stored in {path}; the log above says why. Correct that and "
                "calibrate again (lerobot-calibrate), or the next start searches the stops"
            )
        time.sleep(0.02)
