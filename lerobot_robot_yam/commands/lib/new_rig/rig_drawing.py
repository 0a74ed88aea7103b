"""A rig as a drawing in plain text: which channel is which arm, who leads whom, which cameras there are."""

from collections.abc import Mapping
from typing import Any

from lerobot_robot_yam.commands.lib.new_rig.found_arms import HANDLE
from lerobot_robot_yam.commands.lib.new_rig.rig_plan import PlannedArm, RigPlan

_GAP = "   "
_LED = "^ leads"


def draw_rig(plan: RigPlan) -> str:
    """Followers above, their leaders below, then the cameras."""
    rows = [("follower", plan.followers)]
    rows += [("leader", plan.leaders)] if plan.leaders else []
    texts = {
        (role, side): [f"{side} {role}".strip(), *_words(arm)] for role, arms in rows for side, arm in arms.items()
    }
    width = max(len(line) for lines in texts.values() for line in lines)
    drawing: list[str] = []
    for number, (role, arms) in enumerate(rows):
        if number:
            drawing.append(_GAP.join(_LED.center(width + 4) for _ in arms).rstrip())
        boxes = [_box(texts[role, side], width) for side in arms]
        drawing += [_GAP.join(lines) for lines in zip(*boxes, strict=True)]
    drawing += [f"camera {name}: {_source(camera)}" for name, camera in plan.cameras.items()] or ["no cameras"]
    return "\n".join([f"rig {plan.ident}", *drawing])


def _words(arm: PlannedArm) -> list[str]:
    options = arm.options
    kind = options["arm"] if "kind" not in options else f"{options['kind']} station, follower {options['arm']}"
    load = f", {options['payload_mass_kg']:g} kg on the wrist" if "payload_mass_kg" in options else ""
    end = options.get("gripper", HANDLE)
    return [options["channel"], kind + load, "teaching handle" if end == HANDLE else end, arm.found.mark]


def _box(lines: list[str], width: int) -> list[str]:
    edge = f"+{'-' * (width + 2)}+"
    return [edge, *(f"| {line:<{width}} |" for line in lines), edge]


def _source(camera: Mapping[str, Any]) -> str:
    place = camera.get("camera") or camera.get("index_or_path") or camera.get("serial_number_or_name")
    return f"{camera['type']} {place}, {camera['width']} x {camera['height']} at {camera['fps']} Hz"
