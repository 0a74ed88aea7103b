"""docs/architecture.md: it draws the storeys that are tested, its files exist, and its list for a gripper suffices."""

import contextlib
import re
import sys

import draccus
import numpy as np
import pytest
from lerobot.robots import RobotConfig, make_robot_from_config

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.modes import Mode
from tests import test_layers
from tests.control.test_landing import land_and_watch
from tests.support.landed import MOST_M
from tests.support.pages import block, section
from tests.support.paths import ROOT
from tests.support.rigged import STOPS, arm_on

PAGE = "docs/architecture.md"
LISTS = ("A gripper", "An arm", "An option of an arm", "A console command", "A fault", "A task of the rig")
MOST_FILES = {"A gripper": 6, "A console command": 6, "A fault": 8}
FOLLOWER = "follower_left"
TOY = ROOT / "tests" / "support" / "profiles" / "toy_gripper.yaml"
REACH = [0.3, 0.8, 0.9, -0.2, 0.3, -0.4]


def exists(path):
    """Of a new file, whose name is NAME, the folder."""
    places = ROOT / path, ROOT / "lerobot_robot_yam" / path
    return any((place.parent if "NAME" in place.name else place).exists() for place in places)


def rooms(storey):
    """Rooms of a storey as they are drawn, the lowest first."""
    (row,) = re.findall(rf"^{storey} +(\w.* > .*)$", block(PAGE, "text", " > "), re.MULTILINE)
    return row.split(" > ")[::-1]


def test_the_storeys_are_drawn_as_they_are_tested():
    drawn = re.findall(r"^(\w+) {2,}", block(PAGE, "text", "errors "), re.MULTILINE)
    assert tuple(reversed(drawn)) == test_layers.STOREYS
    assert tuple(rooms("rig")) == test_layers.RIG_ROOMS
    assert tuple("" if room == "loop and controller" else room for room in rooms("control")) == (
        test_layers.CONTROL_ROOMS
    )


@pytest.mark.parametrize("heading", LISTS)
def test_each_file_of_a_list_exists(heading):
    rows = re.findall(r"^\| (`.*?) \|", section(PAGE, heading), re.MULTILINE)
    named = [path for row in rows for path in re.findall(r"`([^`]+)`", row)]
    assert len(rows) >= 5 and not [path for path in named if not exists(path)]


@pytest.mark.parametrize(("heading", "most"), MOST_FILES.items())
def test_adding_takes_few_files(heading, most):
    assert len(re.findall(r"^\| `", section(PAGE, heading), re.MULTILINE)) <= most


def test_the_look_for_files_can_fail():
    assert not exists("arm/nothing.py") and not exists("arm/nothing/NAME.yaml") and exists("commands/NAME.py")


@contextlib.contextmanager
def files_that_run():
    """The files of the packages, below lerobot_robot_yam/, whose functions begin inside the block; not the rig's."""
    monitoring, found = sys.monitoring, set()

    def note(code, _):
        package, _, path = code.co_filename.partition("lerobot_robot_yam/")[2].rpartition("lerobot_robot_yam/")
        if path and code.co_name != "<module>" and not path.startswith("rig/"):
            found.add(path)

    monitoring.use_tool_id(monitoring.PROFILER_ID, "files")
    try:
        monitoring.register_callback(monitoring.PROFILER_ID, monitoring.events.PY_START, note)
        monitoring.set_events(monitoring.PROFILER_ID, monitoring.events.PY_START)
        yield found
    finally:
        monitoring.set_events(monitoring.PROFILER_ID, monitoring.events.NO_EVENTS)
        monitoring.free_tool_id(monitoring.PROFILER_ID)


def test_a_config_and_an_action_pass_the_files_that_the_page_tells():
    page = (ROOT / PAGE).read_text()
    drawn, _ = block(PAGE, "text", "send_action").split("CAN: python-can")
    way = re.findall(r"^[\w ,*-]{22,}?  +(\S+\.py)", drawn, re.MULTILINE)
    told, ran, config = (
        int(re.search(text, page)[1]) for text in (r"the (\d+) files", r"at most (\d+) files", r"passes (\d+) files")
    )
    fields = {"type": "yam_follower", "channel": FOLLOWER, "gripper_stops_rad": STOPS, "gravity_factor": [1.0] * 6}
    with contextlib.closing(LockstepRig(arms=[FOLLOWER])) as rig:
        fields |= {"interface": "yam_lockstep", "isolation": "lockstep", "can_options": {"rig": rig.name}}
        draccus.decode(RobotConfig, fields)  # LeRobot's types are registered once
        with files_that_run() as of_config:
            parsed = draccus.decode(RobotConfig, fields)
            for arm in parsed.arms().values():
                ResolvedArm(arm)
        robot = make_robot_from_config(parsed)
        robot.connect()
        clock, action = robot._arms.clock, robot.get_observation()
        robot.send_action(action)
        clock.sleep(0.1)
        with files_that_run() as of_action:
            robot.send_action(action | {"joint_1.pos": action["joint_1.pos"] + 0.05})
            clock.sleep(1.0 / 250)
        robot.disconnect()
    assert told == len(way) <= 20 and not {path.removeprefix("lerobot_robot_yam/") for path in way} - of_action
    assert len(of_action) <= ran and len(of_config) <= config <= 20  # fewer where the profiles are loaded already


def test_a_gripper_from_one_file_has_a_model_with_its_weight():
    assert load_gripper(TOY).stroke_rad == 3.0
    model = build_model("yam", str(TOY))
    assert [model.joint(i).name for i in range(model.njnt)] == [f"joint{n}" for n in range(1, 9)]
    torque = GravityModel("yam", str(TOY)).torque(np.array(REACH))
    bare = GravityModel("yam", "no_gripper").torque(np.array(REACH))
    assert np.isfinite(torque).all() and abs(torque[1] - bare[1]) > 0.5  # Nm: half a kilogram at the arm's end


def test_a_gripper_from_one_file_comes_up_holds_and_lands():
    """It also finds its stops, which nobody has told it."""
    hardware = {"gripper": str(TOY)}
    with (
        contextlib.closing(LockstepRig(arms=[FOLLOWER], **hardware)) as rig,
        arm_on(rig, FOLLOWER, gripper_stops_rad=None, **hardware) as driven,
    ):
        state = driven.observe()
        assert state.mode is Mode.HOLD
        np.testing.assert_allclose(state.gripper_stops_rad, load_gripper(TOY).calibration.nominal_stops_rad, atol=0.1)
        driven.move_to(REACH, gripper=0.3)
        driven.clock.sleep(1.0)
        held = driven.observe()
        assert held.mode is Mode.HOLD and np.abs(held.q - REACH).max() < 0.05 and abs(held.gripper - 0.3) < 0.02
        moved, fastest = land_and_watch(rig, driven, FOLLOWER)
        assert moved < MOST_M and fastest < 0.75
