"""A module imports only from its own storey or a lower one; docs/architecture.md draws them."""

import ast
from collections import Counter
from pathlib import Path

from tests.support.paths import ROOT

PACKAGES = ("lerobot_robot_yam", "lerobot_strategy_yam", "lerobot_teleoperator_yam")
STOREYS = (
    "errors",
    "system",
    "damiao",
    "arm",
    "mobile",
    "rig",
    "state",
    "control",
    "session",
    "cameras",
    "doctor",
    "setup",
    "waldo",
    "remote",
    "face",
    "plugin",  # the packages' own modules, which LeRobot finds by their names
    "viewer",
    "commands",
)
RIG_ROOMS = (
    "scene",
    "world",
    "devices",
    "bus",
    "simulation",
    "client",
    "render",
    "server",
    "operator",
    "lockstep",
)
# "" is the loop and the arm's controller
CONTROL_ROOMS = ("laws", "landing", "gripper", "safety", "teleop", "preflight", "joints", "", "mobile", "process")
MAY_IMPORT_LEROBOT = ("face", "plugin", "commands")
MOST_MODULES = 15
MOST_LINES = 350  # of a file
MOST_FUNCTION_LINES = 60  # of a function of the control loop


def place(module):
    """(storey, room) of one of our modules; the room is empty on the storey's own floor."""
    package, _, name = module.partition(".")
    parts = name.split(".")
    if package == "lerobot_robot_yam" and parts[0] in STOREYS:
        inner = len(parts) > 2 or (ROOT / package / Path(*parts)).is_dir()
        return parts[0], parts[1] if inner and len(parts) > 1 else ""
    return "plugin", ""


def modules():
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            yield name, path


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
    (ours, room), (theirs, their_room) = place(name), place(imported)
    if ours == theirs == "rig" and room and their_room:
        return RIG_ROOMS.index(their_room) <= RIG_ROOMS.index(room)
    if ours == theirs == "control":
        return CONTROL_ROOMS.index(their_room) <= CONTROL_ROOMS.index(room)
    return STOREYS.index(theirs) <= STOREYS.index(ours)


def wrong(name, imported):
    """Whether module `name` must not import `imported`, ours or not."""
    top = imported.partition(".")[0]
    if top in PACKAGES and imported not in PACKAGES:
        return not allowed(name, imported)
    return top in ("lerobot", "torch") and place(name)[0] not in MAY_IMPORT_LEROBOT


def test_imports_go_downwards():
    found = [f"{name} imports {other}" for name, path in modules() for other in imports(path) if wrong(name, other)]
    assert not found


def test_no_folder_holds_more_than_one_can_look_through():
    folders = Counter(path.parent.relative_to(ROOT) for _, path in modules() if path.name != "__init__.py")
    assert not {folder: count for folder, count in folders.items() if count > MOST_MODULES}


def test_a_file_is_short_enough_to_read_at_once():
    counts = {path: len(path.read_text().splitlines()) for _, path in modules()}
    assert not {path: count for path, count in counts.items() if count > MOST_LINES}


def test_a_function_of_the_control_loop_fits_on_a_screen():
    for name, path in modules():
        if place(name)[0] == "control":
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef):
                    assert node.end_lineno - node.lineno < MOST_FUNCTION_LINES, f"{path}: {node.name}"


def test_a_name_stands_for_one_module():
    names = Counter(path.stem for _, path in modules() if path.stem != "__init__")
    assert not [name for name, count in names.items() if count > 1]


def test_the_rule_can_fail():
    assert not allowed("lerobot_robot_yam.damiao.chain", "lerobot_robot_yam.control.loop")
    assert not allowed("lerobot_robot_yam.control.loop", "lerobot_robot_yam.session.arm_session")
    assert not allowed("lerobot_robot_yam.control.laws.mit_laws", "lerobot_robot_yam.control.landing")
    assert not allowed("lerobot_robot_yam.control.loop", "lerobot_robot_yam.yam_follower")
    assert not allowed("lerobot_robot_yam.rig.world.world", "lerobot_robot_yam.control.arm_controller")
    assert not allowed("lerobot_robot_yam.rig.bus.channel", "lerobot_robot_yam.rig.server.server")
    assert not allowed("lerobot_robot_yam.errors", "lerobot_robot_yam.damiao.codec")
    assert wrong("lerobot_robot_yam.arm.model", "torch") and wrong(
        "lerobot_robot_yam.session.yam_arm", "lerobot.robots"
    )
    assert not wrong("lerobot_robot_yam.yam_follower", "lerobot.robots")
