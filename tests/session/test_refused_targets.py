"""What one connected arm refuses, or holds back and says so; it stays as it was."""

import logging
import time

import numpy as np
import pytest

from lerobot_robot_yam.errors import ActionError, ChannelInUseError, ConfigError, LifeCycleError
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.yam_arm import YamArm
from tests.session.test_arm_session import arm_config


@pytest.fixture(scope="module")
def rig_arm():
    with RigControl.start() as control, YamArm(arm_config(control)) as arm:
        yield arm


@pytest.mark.parametrize(
    "q", [[0, 0, 0, 0, 0], [0, 0, float("nan"), 0, 0, 0], [0, 0, 0, 0, 0, float("inf")], ["a"] * 6, [[0] * 6]]
)
def test_a_bad_target_is_refused_and_nothing_moves(rig_arm, q):
    before = rig_arm.observe().setpoint_q
    with pytest.raises(ActionError, match="left"):
        rig_arm.command(q)
    time.sleep(0.05)
    assert np.array_equal(rig_arm.observe().setpoint_q, before)


def test_targets_beyond_the_joint_limits_are_clamped_and_said(rig_arm, caplog):
    caplog.set_level(logging.INFO)
    asked = rig_arm.command([0, -1.0, 9.0, 0, 0, 0])
    assert asked[1] == 0.0
    assert asked[2] == pytest.approx(3.14159)
    assert "JOINT_LIMIT" in caplog.text
    rig_arm.hold()


def test_a_pose_that_the_arm_cannot_take_is_refused_and_nothing_moves(rig_arm):
    before = rig_arm.observe().setpoint_q
    with pytest.raises(ActionError, match="joint_2 cannot go to -0.50 rad, only within 0.00 … 3.67 rad"):
        rig_arm.move_to([0, -0.5, 1.0, 0, 0, 0])
    time.sleep(0.05)
    assert np.array_equal(rig_arm.observe().setpoint_q, before)


def test_a_state_tells_a_reader_the_pose_and_the_mode(rig_arm):
    text = repr(rig_arm.observe())
    assert text.startswith("<ArmState HOLD q=[") and "gripper=" in text and "°C" in text


def test_only_a_world_of_ones_own_can_be_discarded(rig_arm):
    with pytest.raises(LifeCycleError, match="so that the arms land"):
        rig_arm._session.discard()
    with pytest.raises(ConfigError, match="isolation"):
        ArmSession([rig_arm.config], isolation="somewhere")


@pytest.mark.long
def test_the_channel_lock_names_the_holder(rig_arm):
    with pytest.raises(ChannelInUseError, match=r"follower_left is in use by process \d+"):
        ArmSession([rig_arm.config]).start()
