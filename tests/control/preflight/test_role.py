"""Leaders and followers are told apart without any binding."""

import re

import can
import pytest

from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.control.preflight.role import answering_gripper, mistaken_role
from lerobot_robot_yam.rig.control import running_rig


@pytest.fixture(scope="module")
def shared_rig():
    """For tests that only read."""
    with running_rig() as rig:
        yield rig


@pytest.mark.parametrize(
    ("channel", "gripper", "message"),
    [
        ("leader_left", "linear_4310", r"carries a leader \(a teaching handle answers\).*are the cables"),
        ("leader_left", "no_gripper", r"carries a leader \(a teaching handle answers\).*are the cables"),
        ("follower_left", "yam_teaching_handle", r"carries a follower \(a gripper motor answers.*are the cables"),
        ("follower_left", "no_gripper", "gripper motor .id 7. answers .* but gripper no_gripper has none"),
        ("leader_left", "yam_teaching_handle", None),
        ("follower_left", "linear_4310", None),
        ("follower_left", "linear_3507", None),  # another type of motor: `verify` names that
    ],
)
def test_the_wrong_role_is_named_without_any_binding(shared_rig, channel, gripper, message):
    profile = load_gripper(gripper)
    with can.Bus(interface="yam_sim", channel=channel, rig=shared_rig.name) as bus:
        said = mistaken_role(bus, channel, "left", profile, 7)
        assert said is None if message is None else re.match(f"left: .*{message}", said)


def test_a_dead_gripper_motor_is_not_taken_for_a_leader(rig):
    rig.fault("follower_left", "gripper", "silent")
    with can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name) as bus:
        assert mistaken_role(bus, "follower_left", "left", load_gripper("linear_4310"), 7) is None
    rig.fault("leader_left", None, "handle_silent")
    with can.Bus(interface="yam_sim", channel="leader_left", rig=rig.name) as bus:
        assert mistaken_role(bus, "leader_left", "left", load_gripper("yam_teaching_handle"), 7) is None


@pytest.mark.parametrize("gripper", ["linear_4310", "linear_3507", "no_gripper"])
def test_the_gripper_is_guessed_from_its_motor(gripper):
    with (
        running_rig(gripper=gripper) as rig,
        can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name) as bus,
    ):
        assert answering_gripper(bus, "follower_left", 7) == gripper


def test_a_handle_means_a_teaching_handle(shared_rig):
    with can.Bus(interface="yam_sim", channel="leader_left", rig=shared_rig.name) as bus:
        assert answering_gripper(bus, "leader_left", 7) == "yam_teaching_handle"
