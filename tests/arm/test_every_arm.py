"""Every arm with its profile: brings up, holds, tracks, lands; a profile with other motors is refused."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.arm.profile_files import ARMS, load_arm
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.modes import Mode
from tests.control.test_landing import land_and_watch
from tests.support.landed import MOST_M
from tests.support.rigged import arm_on
from tests.support.tiers import spread

CHANNEL = "follower_left"
REACH = [0.3, 0.8, 0.9, -0.2, 0.3, -0.4]


@contextlib.contextmanager
def rig_of(arm, **options):
    with contextlib.closing(LockstepRig(arms=[CHANNEL], arm=arm, **options)) as rig:
        yield rig


def holds_and_tracks(arm, joints):
    before = arm.observe().q
    arm.clock.sleep(0.3)
    assert arm.observe().mode is Mode.HOLD and np.abs(arm.observe().q - before).max() < 0.02
    arm.move_to(REACH, gripper=0.3)
    arm.clock.sleep(0.3)
    state = arm.observe()
    assert state.q.shape == state.dq.shape == state.tau_nm.shape == (joints,)
    assert np.abs(state.q - REACH).max() < 0.02 and abs(state.gripper - 0.3) < 0.02


@pytest.mark.parametrize("name", ARMS)
def test_it_holds_and_tracks(name):
    """Nothing of a profile but its rest pose is left then, of which tests/arm/test_model.py judges."""
    with rig_of(name) as rig:
        arm = arm_on(rig, CHANNEL, arm=name, gravity_factor=[1.0] * load_arm(name).joint_count).connect()
        holds_and_tracks(arm, load_arm(name).joint_count)
        arm._session.discard()


@pytest.mark.parametrize("name", spread(ARMS, ARMS.index("big_yam")))
def test_it_lands(name):
    joints = load_arm(name).joint_count
    with rig_of(name) as rig, arm_on(rig, CHANNEL, arm=name, gravity_factor=[1.0] * joints) as arm:
        arm.move_to(REACH, gripper=0.3)
        moved, _ = land_and_watch(rig, arm, CHANNEL)
        assert moved < MOST_M


def test_an_ultra_of_the_other_revision_is_refused():
    """They differ in the motor of joint 4, whose torques would be wrong by a factor of 2.8."""
    with rig_of("yam_ultra_2") as rig:
        with pytest.raises(MotorError, match=r"motor joint_4 \(id 4, DM4310\): GR is 40 instead of 10"):
            arm_on(rig, CHANNEL, arm="yam_ultra").connect()
        assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
