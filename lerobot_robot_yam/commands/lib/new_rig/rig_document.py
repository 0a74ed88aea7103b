"""Text of a planned rig: a drawing for the user, and the rig's file, merged with an earlier file."""

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from lerobot_robot_yam.commands.lib.new_rig.found_parts import PASSIVE, FoundArm
from lerobot_robot_yam.commands.lib.new_rig.rig_plan import RigPlan
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER
from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.system.paths import write_whole
from lerobot_robot_yam.system.strict_yaml import merge

_HEAD = """\
# The rig "{ident}", written by yam-setup. lerobot-record and lerobot-teleoperate take this file itself. Configs of all
# commands name it: robot: {{type: yam_rig, file: {name}}}. docs/setup.md says how; docs/options.md lists what can stand
# here. yam-setup keeps the options that you add, but not your comments. yam-setup --check {name} looks for mistakes.
#
# HAZARD: the arms have no brakes. Keep people and things out of their reach, and two stops within yours.

"""
_CAMERAS = "cameras"
_GAP = "   "
_LED = "^ leads"


def draw_rig(plan: RigPlan) -> str:
    """Draw a rig in plain text: followers above, their leaders below, then the cameras."""
    rows = [
        [[f"{side} {role}".strip(), *_words(arm)] for side, arm in arms.items()]
        for role, arms in (("follower", plan.followers), ("leader", plan.leaders))
        if arms
    ]
    if plan.base is not None:
        rows.append([["mobile base", plan.base.channel, plan.base.mark]])
    width = max(len(line) for row in rows for lines in row for line in lines)
    edge, drawing = f"+{'-' * (width + 2)}+", [f"rig {plan.ident}"]
    for number, row in enumerate(rows):
        if number and plan.leaders and number == 1:
            drawing.append(_GAP.join(_LED.center(width + 4) for _ in row).rstrip())
        boxes = [[edge, *(f"| {line:<{width}} |" for line in lines), edge] for lines in row]
        drawing += [_GAP.join(lines) for lines in zip(*boxes, strict=True)]
    drawing += [f"camera {name}: {_source(camera)}" for name, camera in plan.cameras.items()] or ["no cameras"]
    return "\n".join(drawing)


def _words(arm: FoundArm) -> list[str]:
    options = arm.options
    kind = options["arm"] if "kind" not in options else f"{options['kind']} station, follower {options['arm']}"
    load = f", {options['payload_mass_kg']:g} kg on the wrist" if "payload_mass_kg" in options else ""
    end = options.get("gripper", LEADER_GRIPPER)
    return [options["channel"], kind + load, "teaching handle" if end == LEADER_GRIPPER else end, arm.mark]


def _source(camera: Mapping[str, Any]) -> str:
    place = camera.get("camera") or camera.get("index_or_path") or camera.get("serial_number_or_name")
    return f"{camera['type']} {place}, {camera['width']} x {camera['height']} at {camera['fps']} Hz"


def rig_document(plan: RigPlan) -> dict[str, Any]:
    """Return the contents of the rig's file, for LeRobot's parser."""
    if plan.base is None:
        robot = _device(plan.ident, "yam_follower", plan.followers)
    elif plan.followers:
        robot = _device(plan.ident, "", plan.followers) | {"type": "yam_mobile", "base_config": plan.base.options}
    else:
        robot = {"type": "yam_base", "id": plan.ident, **plan.base.options}
    document = {"robot": robot | {_CAMERAS: plan.cameras}}
    if plan.driver:
        document["teleop"] = {"type": plan.driver, "id": plan.ident}
    elif plan.base is not None:
        document["teleop"] = _device(plan.ident, "", plan.leaders) | {"type": "yam_mobile_leader"}
    elif plan.leaders:
        passive = any(arm.role == PASSIVE for arm in plan.leaders.values())
        document["teleop"] = _device(plan.ident, "yam_passive_leader" if passive else "yam_leader", plan.leaders)
    return document


def _device(ident: str, kind: str, arms: Mapping[str, FoundArm]) -> dict[str, Any]:
    if "" in arms:
        return {"type": kind, "id": ident, **arms[""].options}
    return {"type": f"bi_{kind}", "id": ident} | {f"{side}_arm_config": arm.options for side, arm in arms.items()}


def laid_over(earlier: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the new document, with the options kept that a user has added to the earlier file."""
    merged = {}
    for section, device in document.items():
        old = earlier.get(section)
        if not isinstance(old, Mapping) or old.get("type") != device["type"]:
            merged[section] = device
            continue
        merged[section] = merge(old, device)
        if _CAMERAS in device:
            merged[section][_CAMERAS] = _cameras(old.get(_CAMERAS) or {}, device[_CAMERAS])
    return merged


def _cameras(earlier: Mapping[str, Any], cameras: Mapping[str, Any]) -> dict[str, Any]:
    """Return the new cameras; each keeps the options added to an earlier camera of the same name and type."""
    same = {name: earlier.get(name) or {} for name in cameras}
    return {
        name: merge(same[name], camera) if same[name].get("type") == camera["type"] else camera
        for name, camera in cameras.items()
    }


def rig_text(path: Path, plan: RigPlan) -> str:
    """Return the new text of the file at `path`. Options that were added to an earlier, readable file are kept."""
    document: Mapping[str, Any] = rig_document(plan)
    try:
        earlier = yaml.safe_load(path.read_text()) if path.exists() else None
    except (OSError, ValueError, yaml.YAMLError):
        earlier = None  # the user is shown the diff, which includes everything that is removed
    if isinstance(earlier, Mapping):
        document = laid_over(earlier, document)
    body = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    return _HEAD.format(ident=plan.ident, name=path.name) + body


def difference(path: Path, text: str) -> str:
    """Return the changes to the file as a diff; empty if nothing would change."""
    before = path.read_text(errors="replace").splitlines() if path.exists() else []
    return "\n".join(difflib.unified_diff(before, text.splitlines(), str(path), "new", lineterm=""))


def write_rig(path: Path, text: str) -> None:
    """Write the file atomically. Raises SetupError: the file cannot be written; an earlier file is unchanged."""
    try:
        write_whole(path, text)
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error}; nothing was changed") from error
