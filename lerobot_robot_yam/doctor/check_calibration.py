"""Check of the grippers' stored stops: the file exists, is intact and for this gripper, and its span is plausible."""

import json
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.control.gripper.gripper_stops import check_span, load_stops
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.targets import Target
from lerobot_robot_yam.errors import ConfigError, GripperError

_DAY_S = 86400.0
_PATTERN = "*/*/yam/*_gripper.json"  # robots/<type>/yam/<id>_gripper.json below LeRobot's directory


def check_calibrations(targets: Sequence[Target], root: Path, section: Section) -> None:
    """Check the files that the targets name; if no target names a file, all files below LeRobot's directory `root`."""
    if all(target.calibration is None for target in targets):
        for path in sorted(root.glob(_PATTERN)):
            _check_file(path, _owner(path), None, section)
        return
    for target in targets:
        if target.calibration is None or not target.hardware.has_gripper:
            continue
        stops = target.config.gripper_stops_rad
        if stops is None:
            _check_file(target.calibration, target.hardware.gripper.name, target, section)
        else:
            _check_configured(target, stops, section)


def _check_file(path: Path, gripper: str, target: Target | None, section: Section) -> None:
    row: dict[str, Any] = {"channel": target and target.channel, "gripper": gripper, "file": str(path)}
    where = f"{target.channel} gripper" if target else str(path)
    section.rows.append(row)
    calibrate = target.calibrate if target else "lerobot-calibrate of its robot (--config_path=… tells the command)"
    again = f"rm {shlex.quote(str(path))} && {calibrate}"
    try:
        stops = load_stops(where, path, gripper)
        if stops is None:
            row["state"] = "missing"
            what = f"no stops are stored in {path}: a session searches them when it starts, moving the fingers"
            section.warn(where, what, f"take everything out of the fingers, then: {calibrate}")
            return
        row["span_rad"] = round(abs(stops.span_rad), 4)
        row["age_days"] = round((time.time() - path.stat().st_mtime) / _DAY_S, 1)
        profile = target.hardware.gripper if target else load_gripper(gripper)
        if profile.calibration is not None:
            check_span(where, profile.calibration, stops.closed_rad, stops.open_rad)
    except (GripperError, OSError) as error:
        row["state"] = "unusable"
        section.problem(where, str(error), again)
    except ConfigError as error:
        row["state"] = "unknown"
        section.note(where, f"whether the span is plausible is unknown: {error}", "name its config with --config_path")
    else:
        row["state"] = "valid"


def _check_configured(target: Target, stops: Sequence[float], section: Section) -> None:
    gripper = target.hardware.gripper
    row = {"channel": target.channel, "gripper": gripper.name, "file": "gripper_stops_rad of the config"}
    section.rows.append({**row, "state": "configured", "span_rad": round(abs(stops[1] - stops[0]), 4)})
    try:
        if gripper.calibration is not None:
            check_span(target.channel, gripper.calibration, stops[0], stops[1])
    except GripperError as error:
        section.problem(f"{target.channel} gripper", str(error), "take gripper_stops_rad out of the config")


def _owner(path: Path) -> str:
    """Return the name of the gripper in the file; "unknown" if the file is damaged."""
    try:
        data = json.loads(path.read_text())
        return str(data["gripper"])
    except (OSError, ValueError, KeyError, TypeError):
        return "unknown"
