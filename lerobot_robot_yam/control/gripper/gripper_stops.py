"""The gripper's normalised coordinate, search and verification of its stops, and the calibration file.

u = (motor − closed) / (open − closed), 0 closed … 1 open. The stroke exceeds one turn while a motor knows its angle
only within one turn, so stored stops are always verified: an angle that fits two turns is resolved by a gentle move
towards open, with at most the calibration torque. An object between the fingers is not a stop.
"""

import contextlib
import json
import logging
import math
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.arm.profile import Calibration
from lerobot_robot_yam.errors import GripperError
from lerobot_robot_yam.system.paths import write_whole

logger = logging.getLogger(__name__)

_SPEED_RAD_S = 5.0  # search speed; with kd = torque / speed a blocked motor pushes with the calibration torque
_STOP_TOLERANCE_RAD = 0.06  # maximum distance between a stop and its stored angle
_NUDGE_RAD = 0.6  # length of a move that leaves the zone in which two turns fit
_WRONG_WAY_RAD = 0.15  # move against the command that is an error: more than play and a finger's spring
_MOVED_RAD = 0.03  # minimum length of a move; less is play
_FILE_VERSION = 1
_STORE_TIMEOUT_S = 2.0  # timeout for storing the file, s: other programs may write to the disk

Search = Generator[tuple[float, float], tuple[float, float], "GripperStops"]
"""Generator that yields (dq*, kd) for the gripper motor, receives (now_s, motor_rad), and returns the stops."""


@dataclass(frozen=True)
class GripperStops:
    """Joint-space motor angles of both stops, rad, and the shift that moves the present reading to their turn."""

    closed_rad: float
    open_rad: float
    shift_rad: float = 0.0

    def normalised(self, motor_rad: float) -> float:
        """Return the normalised position, 0 closed … 1 open; measured values may lie slightly outside."""
        return (motor_rad - self.closed_rad) / (self.open_rad - self.closed_rad)

    def motor(self, u: float) -> float:
        """Return the motor angle, rad, for the normalised position `u`."""
        return self.closed_rad + u * (self.open_rad - self.closed_rad)

    @property
    def span_rad(self) -> float:
        """Signed difference open − closed, rad."""
        return self.open_rad - self.closed_rad


def check_span(arm: str, calibration: Calibration, closed_rad: float, open_rad: float) -> None:
    """Check that these angles can be the gripper's two stops.

    Raises:
        GripperError: the stops are too close (an object, a blocked finger), too far apart, or inverted (wrong mapping).
    """
    span = abs(open_rad - closed_rad)
    if not calibration.min_span_rad <= span <= calibration.max_span_rad:
        raise GripperError(
            f"{arm}: gripper stops {closed_rad:.3f} (closed) and {open_rad:.3f} (open) span {span:.3f} rad, not "
            f"{calibration.min_span_rad:.2f} … {calibration.max_span_rad:.2f}; take any object out of the fingers, "
            "look for a blocked finger and calibrate again (lerobot-calibrate)"
        )
    if (closed_rad > open_rad) != calibration.closed_is_larger:
        raise GripperError(
            f"{arm}: gripper stops closed {closed_rad:.3f}, open {open_rad:.3f} rad are inverted for this gripper; "
            "check the motor direction in the profile and calibrate again (lerobot-calibrate)"
        )


def _push(
    arm: str, opening: bool, calibration: Calibration, most_rad: float
) -> Generator[tuple[float, float], tuple[float, float], tuple[float, bool]]:
    """Move in one direction until standstill or for `most_rad`; return (motor_rad, whether at standstill)."""
    direction = 1.0 if opening is not calibration.closed_is_larger else -1.0
    kd = calibration.torque_nm / _SPEED_RAD_S
    now, position = yield (0.0, kd)
    start, start_at, checked, checked_at, still = position, now, position, now, 0
    while still < calibration.standstill_checks:
        now, position = yield (direction * _SPEED_RAD_S, kd)
        if direction * (position - start) <= -_WRONG_WAY_RAD:
            raise GripperError(
                f"{arm}: told to {'open' if opening else 'close'}, the gripper moves the other way "
                f"({start:.2f} → {position:.2f} rad): its mapping is inverted, or a hand moves the fingers; "
                "check the gripper and the motor direction in the profile"
            )
        if direction * (position - start) >= most_rad:
            return position, False
        if now - checked_at >= calibration.check_interval_s:
            still = still + 1 if abs(position - checked) < calibration.standstill_rad else 0
            checked, checked_at = position, now
        if now - start_at > calibration.timeout_per_direction_s:
            raise GripperError(
                f"{arm}: gripper still moves {calibration.timeout_per_direction_s:.1f} s after the search began "
                f"({start:.2f} → {position:.2f} rad); is a finger detached from its motor?"
            )
    return position, True


def _never_moved(arm: str, calibration: Calibration, position: float) -> GripperError:
    return GripperError(
        f"{arm}: the gripper does not move from {position:.3f} rad under {calibration.torque_nm:.1f} Nm; "
        "look for jammed fingers and for motor power, then calibrate again (lerobot-calibrate)"
    )


def find_stops(arm: str, calibration: Calibration) -> Search:
    """Search both stops: close, then open, each until standstill, with at most the calibration torque.

    Raises:
        GripperError: the stops are implausible, or the gripper does not move as commanded.
    """
    closed_rad, _ = yield from _push(arm, False, calibration, math.inf)
    open_rad, _ = yield from _push(arm, True, calibration, math.inf)
    if abs(open_rad - closed_rad) < _MOVED_RAD:
        raise _never_moved(arm, calibration, closed_rad)
    check_span(arm, calibration, closed_rad, open_rad)
    logger.info("%s: gripper calibrated, closed %.3f rad, open %.3f rad", arm, closed_rad, open_rad)
    return GripperStops(closed_rad, open_rad)


def _fitting_turns(position: float, stops: GripperStops) -> list[float]:
    low = min(stops.closed_rad, stops.open_rad) - _STOP_TOLERANCE_RAD
    high = max(stops.closed_rad, stops.open_rad) + _STOP_TOLERANCE_RAD
    first, last = math.ceil((low - position) / TURN), math.floor((high - position) / TURN)
    return [turn * TURN for turn in range(first, last + 1)]


def verify_stops(arm: str, calibration: Calibration, stored: GripperStops) -> Search:
    """Shift the reading to the turn of the stored stops, after a short move towards open if two turns fit.

    Raises:
        GripperError: the reading contradicts the stored stops.
    """
    check_span(arm, calibration, stored.closed_rad, stored.open_rad)
    _, position = yield (0.0, 0.0)
    turns = _fitting_turns(position, stored)
    if len(turns) > 1:
        before = position
        position, blocked = yield from _push(arm, True, calibration, _NUDGE_RAD)
        turns = _fitting_turns(position, stored)
        if blocked:  # only the open stop itself may block a gripper that opens
            turns = [turn for turn in turns if abs(position + turn - stored.open_rad) <= _STOP_TOLERANCE_RAD]
            if not turns and abs(position - before) < _MOVED_RAD:
                raise _never_moved(arm, calibration, position)
    if len(turns) != 1:
        raise GripperError(
            f"{arm}: the gripper reads {position:.3f} rad, which does not fit its stored stops closed "
            f"{stored.closed_rad:.3f}, open {stored.open_rad:.3f}; "
            "free its fingers and calibrate again (lerobot-calibrate)"
        )
    return GripperStops(stored.closed_rad, stored.open_rad, shift_rad=turns[0])


def load_stops(arm: str, path: Path, gripper: str) -> GripperStops | None:
    """Load the stored stops; return None if there is no file.

    Raises:
        GripperError: the file is unreadable, damaged, or for another gripper.
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
    """Write the stops atomically. Raises GripperError: the file cannot be written."""
    data = {"version": _FILE_VERSION, "gripper": gripper, "closed_rad": stops.closed_rad, "open_rad": stops.open_rad}
    try:
        write_whole(path, json.dumps(data, indent=1) + "\n")
    except OSError as error:
        raise GripperError(
            f"{arm}: the gripper's stops cannot be stored in {path} ({error}); make room, or correct "
            "`calibration_path` or its permissions, then calibrate again (lerobot-calibrate)"
        ) from error


def await_stored(arm: str, path: Path, gripper: str, closed_rad: float, open_rad: float) -> None:
    """Wait until the control loop has stored the stops found by its search. The loop continues if storing fails.

    Raises:
        GripperError: the file does not contain these stops after 2 s.
    """
    deadline = time.monotonic() + _STORE_TIMEOUT_S
    while True:
        last = time.monotonic() > deadline
        with contextlib.nullcontext() if last else contextlib.suppress(GripperError):  # an old file may be damaged
            stored = load_stops(arm, path, gripper)
            if stored is not None and (stored.closed_rad, stored.open_rad) == (closed_rad, open_rad):
                return
        if last:
            raise GripperError(
                f"{arm}: nothing was stored in {path}; the log above says why. Correct that and "
                "calibrate again (lerobot-calibrate), or the next start searches the stops"
            )
        time.sleep(0.02)
