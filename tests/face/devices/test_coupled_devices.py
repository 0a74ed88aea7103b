"""A leader that knows its follower: what is refused, and which actions couple the two."""

import contextlib
import dataclasses
import importlib

import numpy as np
import pytest
import torch

from lerobot_robot_yam.errors import ChannelInUseError, ConfigError
from lerobot_robot_yam.state.modes import Gate
from lerobot_robot_yam.state.records import channel_key, state_path
from lerobot_robot_yam.system.runtime_dirs import LOCK
from lerobot_robot_yam.system.runtime_files import FileLock, runtime_dir
from lerobot_robot_yam.yam_follower import BiYamFollower
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig, YamLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader
from tests.face.devices.test_lerobot_contract import enabled, follower_config, leader_config, leave
from tests.face.devices.test_pairing import follower, leader
from tests.support.coupled import LEADER, POSE
from tests.support.rigged import rig_of
from tests.support.tiers import spread


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"gate": "auto"}, "gate: set follower"),
        ({"bilateral": 0.2}, "bilateral: set follower"),
        ({"follower": "can1", "engage_threshold_rad": 0.2}, "must exceed release_threshold_rad"),
        ({"follower": "can1", "gate": "button"}, "needs a gate_button"),
        ({"follower": "can1", "gate_button": "top"}, "gate_button is for gate: button"),
        ({"follower": "can1", "gate": "button", "gate_button": "top", "fine_button": "top"}, "one button each"),
        ({"follower": "can1", "bilateral": 0.6}, "bilateral takes gains within 0 … 0.5"),
        ({"follower": "can1", "bilateral": [0.1, 0.2]}, "bilateral takes 6 numbers"),
        ({"follower": "can1", "gate_joints": [7]}, "gate_joints takes numbers of joints within 1 … 6"),
        ({"follower": "can1", "home_rad": [0.0] * 5}, "home_rad takes 6 numbers"),
        ({"follower": "can1", "fine_button": "top", "gripper": "no_gripper"}, "this arm has none"),
        ({"follower": "can1", "fine_scale": float("nan")}, "fine_scale takes"),
        ({"follower": ""}, "follower takes the CAN channel"),
        ({"mirror": True}, "mirror: set follower"),
        ({"follower": "can1", "gate": "auto", "mirror": True}, "gate: auto would take that for a lift"),
    ],
)
def test_options_that_cannot_be_are_refused(options, says):
    with pytest.raises(ConfigError, match=says):
        YamLeaderConfig(channel="can0", **options)


def test_two_leaders_of_one_follower_are_refused():
    arm = LeaderArmConfig(channel="can0", follower="can2")
    with pytest.raises(ConfigError, match="a follower of its own"):
        BiYamLeaderConfig(left_arm_config=arm, right_arm_config=dataclasses.replace(arm, channel="can1"))
    other = dataclasses.replace(arm, channel="can1", follower="can3", engage_threshold_rad=0.7)
    with pytest.raises(ConfigError, match="need the same engage_threshold_rad"):
        BiYamLeaderConfig(left_arm_config=arm, right_arm_config=other)


@pytest.fixture(scope="module")
def rig():
    with rig_of("lockstep") as rig:
        yield rig


def refused(rig, device, kind, says):
    with pytest.raises(kind, match=says):
        device.connect()
    assert not device.is_connected and not any(enabled(rig, LEADER))


def test_a_follower_that_cannot_be_led_is_refused_before_anything_is_energised(rig, tmp_path):
    device = leader(rig, tmp_path, follower="follower_right")
    key = channel_key("yam_lockstep", "follower_right", rig.name)
    state_path(key).symlink_to("/nowhere")
    try:
        with FileLock(runtime_dir() / f"{LOCK}{key}", "test"):
            refused(rig, device, ChannelInUseError, "driven by process")
    finally:
        state_path(key).unlink()
    config = YamLeaderConfig(channel="can_nowhere", follower="can_elsewhere", calibration_dir=tmp_path)
    device = importlib.import_module("lerobot_teleoperator_yam.yam_leader").YamLeader(config)
    refused(rig, device, ConfigError, "can_elsewhere is no CAN interface")


def test_a_follower_of_another_channel_is_refused(rig, tmp_path):
    robot = follower(rig, tmp_path)
    robot.connect()
    try:
        refused(rig, leader(rig, tmp_path, follower="follower_right"), ConfigError, "set its option follower")
    finally:
        leave(robot)


@contextlib.contextmanager
def coupled(rig, directory):
    """Both arms anew, coupled, and their leader swung by a hand."""
    device, robot = leader(rig, directory, follower="follower_left"), follower(rig, directory)
    device.connect()
    robot.connect()
    try:
        rig.hand(LEADER, [2.0], [POSE.tolist()])
        pass_on(device, robot, 3.0)
        assert state_of(robot).coupled
        yield device, robot
    finally:
        leave(device)
        leave(robot)


@pytest.mark.parametrize("space", spread(["joint", "ee"]))
def test_one_arm_may_be_the_leaders_and_the_other_a_policys(tmp_path, space):
    with rig_of("lockstep") as rig:
        config = leader_config(rig.name, tmp_path, action_space=space)
        for side in ("left", "right"):
            getattr(config, f"{side}_arm_config").follower = f"follower_{side}"
        device = BiYamLeader(config)
        robot = BiYamFollower(follower_config(rig.name, tmp_path, action_space=space))
        device.connect()
        robot.connect()

        def lead(pose, seconds, change=lambda action: action):
            for side in ("left", "right"):
                rig.hand(f"leader_{side}", [1.0], [pose.tolist()])
            pass_on(device, robot, seconds, change)
            return robot._arms.newest()

        assert [state.coupled for state in lead(POSE, 2.0)] == [True, True]
        policy = robot.action_for(robot.joints())
        theirs = {key: value for key, value in policy.items() if key.startswith("right_")}
        states = lead(POSE + 0.2, 2.0, lambda action: action | theirs)
        assert [state.coupled for state in states] == [True, False]
        assert states[0].q == pytest.approx(POSE + 0.2, abs=0.03)
        assert states[1].q == pytest.approx(POSE, abs=0.08)
        assert [state.coupled for state in lead(POSE + 0.2, 0.3)] == [True, True]
        leave(device)
        leave(robot)


@pytest.fixture(scope="module")
def pair(rig, tmp_path_factory):
    with coupled(rig, tmp_path_factory.mktemp("coupled")) as devices:
        yield devices


def pass_on(device, robot, seconds, change=lambda action: action):
    """As LeRobot's loops do."""
    until_s = robot.clock.now() + seconds
    while robot.clock.now() < until_s:
        robot.send_action(change(device.get_action()))
        robot.clock.sleep(1 / 30)


def state_of(device):
    return device._arms.newest()[0]


@pytest.mark.parametrize(
    "wrapped", [torch.tensor, lambda value: torch.tensor(value, dtype=torch.float64), lambda value: round(value, 4)]
)
def test_the_leaders_own_action_couples_whatever_its_numbers_are_wrapped_in_or_rounded_to(pair, wrapped):
    device, robot = pair
    pass_on(device, robot, 0.3)
    assert state_of(robot).coupled and state_of(device).gate is Gate.ENGAGED
    pass_on(device, robot, 0.3, lambda action: {key: wrapped(value) for key, value in action.items()})
    assert state_of(robot).coupled


def test_an_action_that_was_changed_does_not_couple_and_that_is_said(pair, caplog):
    device, robot = pair
    pass_on(device, robot, 0.3)
    with caplog.at_level("INFO"):
        pass_on(device, robot, 0.5, lambda action: action | {"joint_1.pos": action["joint_1.pos"] + 1e-3})
    robot.clock.sleep(0.02)
    assert not state_of(robot).coupled
    assert caplog.text.count("sends another joint_1.pos than this leader's") == 1
    pass_on(device, robot, 0.3)
    assert state_of(robot).coupled


def test_an_older_or_repeated_action_of_the_leader_does_not_couple(rig, pair):
    device, robot = pair
    pass_on(device, robot, 0.3)
    rig.hand(LEADER, [0.5], [(POSE + 0.2).tolist()])
    repeated = device.get_action()
    for _ in range(30):
        robot.send_action(repeated)
        robot.clock.sleep(1 / 30)
    assert not state_of(robot).coupled
    assert state_of(robot).setpoints == pytest.approx(list(repeated.values()), abs=1e-3)
    assert np.abs(state_of(device).q - state_of(robot).q).max() > 0.1
    assert device.get_action() != repeated
    robot.send_action(repeated)
    robot.clock.sleep(0.02)
    assert not state_of(robot).coupled
    rig.hand(LEADER, [0.5], [POSE.tolist()])
    pass_on(device, robot, 1.0)
    assert state_of(robot).coupled


def test_the_action_is_the_followers_target_while_coupled(rig, pair):
    """Also while the leader moves, so that its own pose is another."""
    device, robot = pair
    pass_on(device, robot, 0.3)
    rig.hand(LEADER, [0.7, 2.0], [(POSE + 0.9).tolist(), POSE.tolist()])
    behind = []
    for _ in range(30):
        before = state_of(robot)
        action = list(device.get_action().values())
        after = state_of(robot)
        targets = np.array([before.action, after.action])
        low, high = targets.min(axis=0) - 1e-3, targets.max(axis=0) + 1e-3
        assert ((action >= low) & (action <= high)).all()
        behind.append(np.abs(action[:6] - state_of(device).q).max())
        robot.send_action(dict(zip(robot.action_features, action, strict=True)))
        robot.clock.sleep(1 / 30)
    assert max(behind) > 0.01
    pass_on(device, robot, 2.0)
