"""Channels are told apart before anything moves: a base configured on an arm's, an arm on a base's."""

import contextlib

import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import ControlMode
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.session.yam_base import YamBase
from tests.support.base_rig import motors


def on(rig, channel):
    return {"channel": channel, "interface": "yam_lockstep", "can_options": {"rig": rig.name}}


@pytest.mark.parametrize("arm", ["yam", "big_yam"])
def test_a_base_on_an_arms_channel_says_that_it_is_an_arms(arm):
    with contextlib.closing(LockstepRig(arms=["follower_left"], arm=arm)) as rig:
        rig.trace_start("follower_left")
        with pytest.raises(MotorError, match="^base: channel follower_left carries an arm: are cables"):
            YamBase(**on(rig, "follower_left"), isolation="lockstep").connect()
        assert {identifier for _, _, identifier, _ in rig.trace("follower_left")} == {0x7FF}


@pytest.mark.parametrize("gripper", ["linear_4310", "yam_teaching_handle"])
def test_an_arm_on_a_bases_channel_says_that_it_is_a_bases(gripper):
    with contextlib.closing(LockstepRig("mobile")) as rig:
        config = ArmConfig(name="left", gripper=gripper, **on(rig, "base"))
        with pytest.raises(MotorError, match="^left: channel base carries a mobile base: are cables"):
            YamArm(config, isolation="lockstep").connect()
        assert not any(motor["enabled"] for motor in motors(rig).values())


def test_a_wheel_in_another_mode_is_named_and_a_silent_one_is_no_arm():
    with contextlib.closing(LockstepRig("mobile")) as rig:
        rig.fault("base", "front_left_drive", "register", ControlMode.MIT, register=int(Register.CTRL_MODE))
        with pytest.raises(MotorError, match=r"front_left_drive \(id 4, DM_FLOW_WHEEL\): CTRL_MODE is 1 instead of 3"):
            YamBase(**on(rig, "base"), isolation="lockstep").connect()
        rig.fault("base", "rear_left_steer", "silent")
        with pytest.raises(MotorError, match=r"no answer from 1 of 8 motors: rear_left_steer \(id 1\)"):
            YamBase(**on(rig, "base"), isolation="lockstep").connect()
