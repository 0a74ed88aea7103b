"""A follower that a hand guides: it floats, its action is where it was led, its gripper obeys keys."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig, YamFollowerConfig
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.yam_follower import BiYamFollower, YamFollower
from lerobot_teleoperator_yam.config_yam_hand_guide import BiYamHandGuideConfig, YamHandGuideConfig
from lerobot_teleoperator_yam.yam_hand_guide import BiYamHandGuide, YamHandGuide
from tests.support.rigged import STOPS, lockstep_rig

ARMS = ("follower_left", "follower_right")
RAISED = np.array([0.2, 1.0, 0.9, -0.3, 0.1, 0.2])
THERE = np.array([-0.3, 1.3, 1.2, -0.5, -0.2, 0.5])
FRAME_S = 1 / 30
BARE = """
name: bare
extends: bimanual_table
arms: [{channel: follower_left, role: follower, arm: yam, gripper: no_gripper, position_m: [0.0, 0.25, 0.0]}]
"""
rig = lockstep_rig(*ARMS)


def arm_fields(rig, channel):
    return {
        "channel": channel,
        "interface": "yam_lockstep",
        "can_options": {"rig": rig.name},
        "gravity_factor": [1.0] * 6,
        "gripper_stops_rad": STOPS,
    }


@pytest.fixture
def devices(rig):
    """A hand guide and a follower, connected as LeRobot does it; the arm is raised."""
    guide = YamHandGuide(YamHandGuideConfig())
    follower = YamFollower(YamFollowerConfig(isolation="lockstep", **arm_fields(rig, ARMS[0])))
    rig.set_pose(ARMS[0], RAISED.tolist())
    guide.connect()
    follower.connect()
    yield rig, guide, follower
    guide.disconnect()
    follower.discard()


def mode(follower):
    return follower._arms.newest()[0].mode


def frames(rig, guide, follower, seconds):
    """Run LeRobot's loop; returns the actions."""
    actions = []
    for _ in range(round(seconds / FRAME_S)):
        follower.get_observation()
        action = guide.get_action()
        assert follower.send_action(action) == pytest.approx(action)
        actions.append(action)
        follower.clock.sleep(FRAME_S)
    return actions


@pytest.fixture
def floating(devices):
    """The same, and what the guide's actions were since the arm floats."""
    return *devices, frames(*devices, 0.3)


def test_it_floats_and_the_action_is_where_it_was_led_without_a_fight(floating):
    rig, guide, follower, _ = floating
    rig.lift(ARMS[0], THERE.tolist(), 1.5)
    actions = frames(rig, guide, follower, 2.5)
    assert mode(follower) is Mode.FLOAT
    arm = rig.state()["arms"][ARMS[0]]
    np.testing.assert_allclose(arm["q"], THERE, atol=0.08)
    assert arm["held"]  # the arm has not worked against the hand
    last = np.array([*actions[-1].values()])
    np.testing.assert_allclose(last[:6], arm["q"], atol=2e-3)
    assert list(actions[-1]) == [*follower.action_features]
    assert np.linalg.norm(rig.forces(ARMS[0])["hand_n"]) < 6.0  # friction; with 2.5 cm to go a held arm takes 60 N
    rig.release(ARMS[0])
    follower.clock.sleep(0.5)
    np.testing.assert_allclose(rig.state()["arms"][ARMS[0]]["q"], arm["q"], atol=0.02)  # never limp


def test_another_action_ends_it_without_a_jump(floating):
    rig, _, follower, actions = floating
    before = np.array(rig.state()["arms"][ARMS[0]]["q"])
    other = actions[-1] | {"joint_1.pos": actions[-1]["joint_1.pos"] + 0.2}
    fastest = 0.0
    for _ in range(30):
        follower.send_action(other)
        follower.clock.sleep(FRAME_S)
        fastest = max(fastest, np.abs(rig.state()["arms"][ARMS[0]]["dq"]).max())
    assert mode(follower) is Mode.TRACK
    np.testing.assert_allclose(rig.state()["arms"][ARMS[0]]["q"] - before, [0.2, 0, 0, 0, 0, 0], atol=0.03)
    assert fastest < 1.65


def test_a_key_closes_and_opens_the_gripper_while_the_arm_floats(floating):
    rig, guide, follower, _ = floating
    guide._openings = [1.0]
    for opening in (0.0, 1.0):
        guide._typed("g")
        actions = frames(rig, guide, follower, 1.5)
        assert actions[-1]["gripper.pos"] == opening
        assert rig.state()["arms"][ARMS[0]]["opening"] == pytest.approx(opening, abs=0.03)
        assert mode(follower) is Mode.FLOAT
    guide._typed("x")
    assert frames(rig, guide, follower, 0.1)[-1]["gripper.pos"] == 1.0


def test_during_an_emergency_stop_it_holds_and_afterwards_floats_again(floating):
    rig, guide, follower, _ = floating
    stop = EmergencyStop()
    stop.latch("test")
    try:
        frames(rig, guide, follower, 0.5)
        assert mode(follower) is Mode.STOPPED
    finally:
        stop.release()
    frames(rig, guide, follower, 0.5)
    assert mode(follower) is Mode.FLOAT


def test_without_actions_it_holds_until_the_next_one(floating):
    rig, guide, follower, _ = floating
    follower.clock.sleep(0.4)
    assert mode(follower) is Mode.FLOAT
    follower.clock.sleep(0.2)
    assert mode(follower) is Mode.HOLD
    frames(rig, guide, follower, 0.2)
    assert mode(follower) is Mode.FLOAT


@pytest.mark.long
def test_an_arm_that_is_pulled_at_floats_again_once_it_is_let_go(floating):
    rig, guide, follower, _ = floating
    follower.clock.sleep(0.7)
    rig.lift(ARMS[0], THERE.tolist(), 1.0, gives_way=False)
    follower.clock.sleep(1.5)
    frames(rig, guide, follower, 0.5)
    assert mode(follower) is Mode.HOLD
    rig.release(ARMS[0])
    frames(rig, guide, follower, 1.0)
    assert mode(follower) is Mode.FLOAT


def test_an_arm_without_a_gripper_floats_for_as_long_as_actions_come(tmp_path):
    scene = tmp_path / "bare.yaml"
    scene.write_text(BARE)
    with contextlib.closing(LockstepRig(scene)) as rig:
        guide = YamHandGuide(YamHandGuideConfig(gripper="no_gripper"))
        fields = arm_fields(rig, ARMS[0]) | {"gripper": "no_gripper", "gripper_stops_rad": None}
        follower = YamFollower(YamFollowerConfig(isolation="lockstep", **fields))
        guide.connect()
        follower.connect()
        try:
            frames(rig, guide, follower, 1.5)
            assert mode(follower) is Mode.FLOAT
        finally:
            guide.disconnect()
            follower.discard()


def test_without_the_guide_it_holds(floating):
    rig, guide, follower, _ = floating
    guide.disconnect()
    assert mode(follower) is Mode.HOLD


def test_a_motor_that_fails_is_named(floating):
    rig, guide, follower, _ = floating
    rig.fault(ARMS[0], "joint_2", "nibble", 0xA)
    follower.clock.sleep(0.2)
    with pytest.raises(MotorError, match="joint_2"):
        guide.get_action()


@contextlib.contextmanager
def two_devices(rig, **right):
    """A hand guide of two arms and both followers, connected; `right`: options of the right arm."""
    guide = BiYamHandGuide(BiYamHandGuideConfig())
    arms = {f"{name.removeprefix('follower_')}_arm_config": arm_fields(rig, name) for name in ARMS}
    arms["right_arm_config"] |= right
    arms = {name: FollowerArmConfig(**fields) for name, fields in arms.items()}
    follower = BiYamFollower(BiYamFollowerConfig(isolation="lockstep", **arms))
    for name in ARMS:
        rig.set_pose(name, RAISED.tolist())
    guide.connect()
    follower.connect()
    try:
        yield guide, follower
    finally:
        guide.disconnect()
        follower.discard()


def test_two_followers(rig):
    with two_devices(rig) as (guide, follower):
        action = frames(rig, guide, follower, 0.3)[-1]
        assert list(action) == [*follower.action_features]
        assert [state.mode for state in follower._arms.newest()] == [Mode.FLOAT] * 2
        guide._typed("j")
        action = frames(rig, guide, follower, 0.5)[-1]
        assert action["right_gripper.pos"] != pytest.approx(action["left_gripper.pos"])


def test_none_of_two_followers_floats_alone(rig):
    with two_devices(rig, gravity_factor=[0.2] * 6) as (guide, follower):  # the right one would run away
        follower.clock.sleep(1.0)
        with pytest.raises(LifeCycleError, match="right_follower does not float"):
            guide.get_action()
        assert [state.mode for state in follower._arms.newest()] == [Mode.HOLD] * 2


def test_a_second_follower_is_refused_while_the_first_is_guided(devices):
    rig, guide, follower = devices
    frames(rig, guide, follower, 0.2)
    second = YamFollower(YamFollowerConfig(isolation="lockstep", **arm_fields(rig, ARMS[1])))
    with pytest.raises(ConfigError, match="guides yam_follower already; disconnect that first"):
        second.connect()
    second.disconnect()
    assert not second.is_connected
    frames(rig, guide, follower, 0.7)  # the first goes on as before
    assert mode(follower) is Mode.FLOAT


def test_a_guide_of_another_arm_is_refused_before_anything_is_energised(rig):
    guide = BiYamHandGuide(BiYamHandGuideConfig())
    follower = YamFollower(YamFollowerConfig(isolation="lockstep", **arm_fields(rig, ARMS[0])))
    guide.connect()
    try:
        with pytest.raises(ConfigError, match=r"bi_yam_hand_guide and yam_follower: only one has .*joint_1\.pos"):
            follower.connect()
        assert not follower.is_connected
        assert not any(motor["enabled"] for motor in rig.state()["arms"][ARMS[0]]["motors"].values())
        with pytest.raises(ConfigError, match="has a bi_yam_hand_guide already"):
            YamHandGuide(YamHandGuideConfig()).connect()
    finally:
        guide.disconnect()


def test_without_a_follower_there_is_no_action():
    guide = YamHandGuide(YamHandGuideConfig())
    guide.connect()
    try:
        with pytest.raises(LifeCycleError, match="connect that first"):
            guide.get_action()
    finally:
        guide.disconnect()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: YamHandGuideConfig(gripper_key="n"), "one small letter that LeRobot has no use for"),
        (lambda: YamHandGuideConfig(gripper_key="D"), "one small letter"),  # the end of an arrow's sequence
        (lambda: YamHandGuideConfig(gripper_key="N"), "one small letter"),  # n to LeRobot
        (lambda: YamHandGuideConfig(gripper_key="go"), "one small letter"),
        (lambda: BiYamHandGuideConfig(left_gripper_key="j"), "both grippers have the key 'j'"),
        (lambda: YamHandGuideConfig(arm="yum"), "yum"),
        (lambda: YamHandGuideConfig(action_space="tool"), "must be joint or ee"),
    ],
)
def test_what_a_config_refuses(make, message):
    with pytest.raises(ConfigError, match=message):
        make()
