"""docs/architecture.md: it draws the storeys that are tested, its files exist, and its list for a gripper suffices."""

import contextlib
import re

import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.modes import Mode
from tests import test_layers
from tests.control.test_landing import land_and_watch
from tests.support.landed import MOST_M
from tests.support.pages import block, section
from tests.support.paths import ROOT
from tests.support.rigged import arm_on

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
