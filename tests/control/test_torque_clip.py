"""No command asks a motor for more torque than its clip: seen by the rig, which knows what each command asks for.

The motors' own saturation is no judge of it: the profile's clips are as wide. So these arms have narrower ones.
"""

import numpy as np
import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.support.asked import beyond_nm, look_at
from tests.support.rigged import lockstep_rig, session_on, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
CLIP_NM = np.array([8.0, 14.0, 12.0, 4.0, 3.0, 2.0])
NEAR = np.array([0.0, 1.0, 1.2, 0.0, 0.0, 0.0])

rig = lockstep_rig(CHANNEL)


@pytest.fixture
def session(rig):
    session = session_on(rig, sim_config(rig, CHANNEL, torque_limit_nm=CLIP_NM.tolist()))
    session.start()
    track(session, {CHANNEL: NEAR}, 1.2)
    look_at(rig, CHANNEL)
    yield session
    session.discard()


def assert_within_clip(rig):
    beyond = beyond_nm(rig, CHANNEL, ResolvedArm(sim_config(rig, CHANNEL, torque_limit_nm=CLIP_NM.tolist())))
    assert not beyond.any(), beyond


@pytest.mark.parametrize("joint", spread([1, 3, 6], 0))
def test_a_blocked_joint_is_pressed_with_its_clip_and_no_more(rig, session, joint):
    rig.fault(CHANNEL, f"joint_{joint}", "stuck")
    far = NEAR.copy()
    far[joint - 1] += 0.8
    track(session, {CHANNEL: far}, 1.0)
    assert_within_clip(rig)
    pressed_nm = np.abs(recorders.truth(rig, CHANNEL)["torque_nm"][:, joint - 1]).max()
    assert pressed_nm == pytest.approx(CLIP_NM[joint - 1], rel=0.02)  # it does press
    assert Limited.TORQUE in session[CHANNEL].observe().limited


def test_a_blow_is_not_answered_with_more_than_the_clip(rig, session):
    """It is the damping that asks for it, and the spring soon after."""
    rig.push(CHANNEL, "gripper", [0.0, 60.0, 0.0], 0.3)
    track(session, {CHANNEL: NEAR}, 1.0)
    assert_within_clip(rig)
    assert np.abs(recorders.truth(rig, CHANNEL)["dq"][:, 0]).max() > 3.0
