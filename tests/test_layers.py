"""A module imports only downwards: LeRobot's face → arm → damiao → base; commands above the arm, the rig beside it."""

import ast
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PACKAGES = ("lerobot_robot_yam", "lerobot_teleoperator_yam")
BASE = {
    "clock",
    "errors",
    "log_thread",
    "other_plugins",
    "paths",
    "runtime",
    "sealed_memory",
    "shared_block",
    "realtime",
    "sleep_lock",
}
TOOLS = {"commands", "doctor"}  # console commands: above the arm, without LeRobot
# What the rig may use of the arm: how it is built, not how it is driven.
ARM_DESCRIPTION = {
    "arm.model",
    "arm.mounting",
    "arm.profile",
    "arm.dynamics",
    "arm.kinematics",
    "arm.shapes",
    "arm.yaml_fields",
}
# What LeRobot's face may use of the rig: its clients, not its insides.
RIG_CLIENTS = {
    "cameras",
    "control",
    "demonstrator",
    "lockstep",
    "lockstep_cameras",
    "operators.setup",
    "scene",
    "tasks",
}


def layer(module):
    """Layer of one of our modules."""
    package, _, name = module.partition(".")
    first = name.partition(".")[0]
    if package == "lerobot_robot_yam" and first in BASE:
        return "base"
    if package == "lerobot_robot_yam" and first in TOOLS:
        return "tools"
    if package == "lerobot_robot_yam" and first in ("arm", "damiao", "rig"):
        return first
    return "face"


def modules():
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            yield pytest.param(name, path, id=name)


def imports(path):
    """Absolute names of all modules that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module)
            inner = ROOT / Path(*node.module.split("."))
            if inner.is_dir():  # `from package import module`
                found |= {f"{node.module}.{a.name}" for a in node.names if (inner / f"{a.name}.py").is_file()}
    return found


def allowed(name, imported):
    """Whether module `name` may import module `imported`, one of ours."""
    ours, theirs = layer(name), layer(imported)
    below = {
        "base": {"base"},
        "damiao": {"damiao", "base"},
        "arm": {"arm", "damiao", "base"},
        "rig": {"rig", "damiao", "base"},
        "tools": {"tools", "arm", "damiao", "base"},
        "face": {"face", "arm", "damiao", "base"},
    }
    if ours == "rig" and theirs == "arm":
        return imported.removeprefix("lerobot_robot_yam.") in ARM_DESCRIPTION
    if ours == "face" and theirs == "rig":
        return imported.removeprefix("lerobot_robot_yam.rig.") in RIG_CLIENTS
    return theirs in below[ours]


@pytest.mark.parametrize("name, path", list(modules()))
def test_imports_go_downwards(name, path):
    for imported in imports(path):
        top = imported.partition(".")[0]
        if top in PACKAGES and imported not in PACKAGES:
            assert allowed(name, imported), f"{name} imports {imported}"
        if top in ("lerobot", "torch"):
            assert layer(name) == "face", f"{name} imports {imported}"


def test_the_rule_can_fail():
    assert not allowed("lerobot_robot_yam.damiao.chain", "lerobot_robot_yam.control.loop")
    assert not allowed("lerobot_robot_yam.control.loop", "lerobot_robot_yam.rig.world.world")
    assert not allowed("lerobot_robot_yam.control.loop", "lerobot_robot_yam.yam_follower")
    assert not allowed("lerobot_robot_yam.rig.world.world", "lerobot_robot_yam.control.arm_controller")
    assert not allowed("lerobot_robot_yam.yam_env", "lerobot_robot_yam.rig.world.world")
    assert not allowed("lerobot_robot_yam.errors", "lerobot_robot_yam.damiao.codec")
