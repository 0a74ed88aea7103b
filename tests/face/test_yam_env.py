"""A robot as an environment: in lock-step, and what it refuses."""

import contextlib
import itertools

import draccus
import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.envs.utils import NEW_ROLLOUT_OPTION

from lerobot_robot_yam.commands.configs import config_path
from lerobot_robot_yam.commands.data.gathering import demonstrate
from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.config_yam_env import YamEnvConfig
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig, YamFollowerConfig
from lerobot_robot_yam.config_yam_mobile import MobileBaseConfig, YamMobileConfig
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.yam_env import YamEnv
from tests.support.tiers import spread


def robot(tmp_path, **fields):
    camera = YamSimCameraConfig(camera="top", width=64, height=48)
    fields = {"cameras": {"top": camera}, "gravity_factor": [1.0] * 6, **fields}
    where = {"interface": "yam_sim", "channel": "follower_left"}
    return YamFollowerConfig(**{**where, "calibration_dir": tmp_path, **fields})


@pytest.fixture
def lockstep(tmp_path):
    env = YamEnv(YamEnvConfig(robot=robot(tmp_path), lockstep=True))
    yield env
    env.close()


def test_it_is_an_environment(lockstep):
    observation, info = lockstep.reset(seed=3)
    assert lockstep.observation_space.contains(observation)
    assert info == {"is_success": False}
    assert lockstep.task_description.startswith("Lift")
    assert lockstep.metadata["render_fps"] == 30 and lockstep._max_episode_steps == 15 * 30
    action = observation["agent_pos"]
    assert lockstep.action_space.contains(action)
    for _ in range(3):
        observation, reward, terminated, truncated, info = lockstep.step(action)
        assert lockstep.observation_space.contains(observation) and lockstep.render().shape == (48, 64, 3)
        assert (reward, terminated, truncated, info) == (0.0, False, False, {"is_success": False})


def test_a_demonstration_keeps_what_was_sent_not_what_was_asked_for(tmp_path):
    config = YamEnvConfig(robot=robot(tmp_path, max_relative_target=0.03), lockstep=True)
    with contextlib.closing(YamEnv(config)) as env:
        frames = list(itertools.islice(demonstrate(env, seed=0), 60))
    far = [np.abs(frame.action - frame.observation["agent_pos"])[:6].max() for frame in frames]
    assert 0.02 < max(far) < 0.031


@pytest.mark.long
def test_a_demonstration_of_a_mobile_robot_drives_its_base(tmp_path):
    arms = {
        f"{side}_arm_config": FollowerArmConfig(channel=f"follower_{side}", gravity_factor=[1.0] * 6)
        for side in ("left", "right")
    }
    mobile = YamMobileConfig(**arms, base_config=MobileBaseConfig(channel="base"), calibration_dir=tmp_path)
    with contextlib.closing(YamEnv(YamEnvConfig(robot=mobile, task="mobile_tables", lockstep=True))) as env:
        frames = list(itertools.islice(demonstrate(env, seed=0), 100))
        x, y, theta = env._rig.state()["base"]["pose"]
    assert frames[0].action.shape == (17,) and max(frame.action[14] for frame in frames) > 0.2
    assert -0.05 < x < 0.02 and [y, theta] == pytest.approx([0.0, 0.0], abs=0.02)  # from -0.35


@pytest.mark.long
def test_a_gripper_that_holds_something_keeps_no_episode_from_beginning(tmp_path):
    pose = [0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    env = YamEnv(YamEnvConfig(robot=robot(tmp_path), lockstep=True, reset_pose=pose))
    try:
        env.reset(seed=1)
        for _ in range(30):
            observation = env.step(np.array([0.2, *pose[1:6], 0.6]))[0]
        assert observation["agent_pos"][6] > 0.5
        env._rig.fault("follower_left", "gripper", "stuck")  # a live rig's gripper keeps what it has closed on
        env._go_to_start(env._robot)
        assert np.abs(env._robot.joints() - pose)[:6].max() < 0.06
    finally:
        env.close()


@pytest.mark.long
def test_seeds_differ_and_time_is_up_without_success(tmp_path):
    env = YamEnv(YamEnvConfig(robot=robot(tmp_path), lockstep=True, time_limit_s=0.5, render_camera="overview"))
    try:
        first, shown = env.reset(seed=1)[0], env.render()
        second = env.reset(seed=2)[0]
        assert shown.shape == (240, 320, 3)  # not what the policy sees
        assert (env.render() != shown).any()
        assert np.array_equal(first["agent_pos"], second["agent_pos"])  # the arm waits at the same place
        assert (first["pixels"]["top"] != second["pixels"]["top"]).any()
        outcomes = [env.step(second["agent_pos"])[1:4] for _ in range(15)]
        assert outcomes == [(0.0, False, False)] * 14 + [(0.0, False, True)]
    finally:
        env.close()


@pytest.mark.long
def test_a_seed_has_its_own_look_again(tmp_path):
    config = YamEnvConfig(robot=robot(tmp_path), lockstep=True, rig_options={"randomise_look": 1.0})
    with contextlib.closing(YamEnv(config)) as env:
        first, other, again = (env.reset(seed=seed)[0]["pixels"]["top"].astype(int) for seed in (1, 2, 1))
    assert np.array_equal(first, again)
    assert (np.abs(first - other) > 10).mean() > 0.2  # not only where the cube lies


def test_bad_actions_are_refused_and_nothing_moves(lockstep):
    observation, _ = lockstep.reset(seed=3)
    for action, says in (([np.nan] * 7, "joint_1"), ([0.0] * 6, "6 values, the robot takes 7")):
        with pytest.raises(ActionError, match=says):
            lockstep.step(np.array(action))
    after, *_ = lockstep.step(observation["agent_pos"])
    assert np.abs(after["agent_pos"] - observation["agent_pos"]).max() < 0.01


def two_arms(tmp_path):
    arms = {
        f"{side}_arm_config": FollowerArmConfig(
            interface="yam_sim", channel=f"follower_{side}", gravity_factor=[1.0] * 6
        )
        for side in ("left", "right")
    }
    return BiYamFollowerConfig(calibration_dir=tmp_path, **arms)


@pytest.mark.long
def test_a_reset_between_two_tool_poses_begins_a_new_path(tmp_path):
    """The same pose can be had turned round and bent over backward: the arm stays as the reset has put it."""
    options = {"action_space": "ee", "command_timeout_s": 5.0, "cameras": {}}
    env = YamEnv(YamEnvConfig(robot=robot(tmp_path, **options), lockstep=True))
    try:
        for q in ([2.6, 0.36, 1.01, 1.03, -0.69, -1.36], [-0.54, 0.8, 0.97, 1.29, 0.69, 1.78]):
            env.reset(seed=1)
            follower, _ = env._connected()
            for _ in range(90):
                follower.send_joints(np.array([*q, 1.0]))
                follower.clock.sleep(1 / 30)
            follower.clock.sleep(0.5)
            pose = env.action_of(np.array([*q, 1.0]))
            for _ in range(30):
                env.step(pose)
            assert np.abs(follower.joints()[:6] - q).max() < 0.2
    finally:
        env.close()


def test_a_finished_environment_freezes_until_a_new_rollout(tmp_path):
    config = YamEnvConfig(robot=robot(tmp_path, cameras={}), lockstep=True, time_limit_s=0.1)
    (vector,) = config.create_envs(1)["yam"].values()
    try:
        observation, _ = vector.reset(seed=[4])
        for _ in range(6):  # the third step ends it; gymnasium would reset it then
            last, *_ = vector.step(observation["agent_pos"])
        rig, _ = vector.envs[0].unwrapped.lockstep_task()
        assert rig.restarts == 0
        assert last["agent_pos"].shape == (1, 7)
        vector.reset(seed=[5], options={NEW_ROLLOUT_OPTION: True})
        assert rig.restarts == 1
    finally:
        vector.close()


def test_a_robot_that_cannot_be_is_told_while_the_config_is_read(tmp_path):
    path = tmp_path / "eval.yaml"
    path.write_text(config_path("train/lift_and_place_eval").read_text().replace("linear_4310", "linear_4130"))
    with pytest.raises(DecodingError, match="unknown gripper 'linear_4130'; did you mean 'linear_4310'"):
        draccus.parse(EvalPipelineConfig, path, args=[])


@pytest.mark.parametrize("limit_s", spread([1.0, 16.0], 0))
def test_an_episode_is_as_long_as_configured_whatever_the_task_says(tmp_path, limit_s):
    env = YamEnv(YamEnvConfig(robot=robot(tmp_path, cameras={}), lockstep=True, time_limit_s=limit_s, fps=5))
    try:
        observation, _ = env.reset(seed=4)
        for _ in range(round(5 * limit_s)):
            *_, over, cut, _ = env.step(observation["agent_pos"])
            assert not over
        assert cut
    finally:
        env.close()


def test_what_cannot_be_is_said(tmp_path):
    with pytest.raises(ConfigError, match="choose the robot"):
        YamEnvConfig().create_envs(1)
    real = YamFollowerConfig(channel="can0", calibration_dir=tmp_path)
    with pytest.raises(ConfigError, match="batch_size=1"):
        YamEnvConfig(robot=real).create_envs(2)
    with pytest.raises(ConfigError, match="operator or module:function"):
        YamEnv(YamEnvConfig(robot=real)).reset()
    with pytest.raises(ConfigError, match="no task 'juggle'"):
        YamEnv(YamEnvConfig(robot=robot(tmp_path), task="juggle"))
    with pytest.raises(ConfigError, match="not 'rig', 'operator' or module:function"):
        YamEnv(YamEnvConfig(robot=real, success="nobody:knows")).reset()
    opencv = YamSimCameraConfig(camera="attic", width=64, height=48)
    env = YamEnv(YamEnvConfig(robot=robot(tmp_path, cameras={"attic": opencv}), lockstep=True))
    with pytest.raises(ConfigError, match="attic"):
        env.reset()
    env.close()


@pytest.mark.parametrize(
    "pose, says",
    [
        ([0.1] * 6, "6 values, not 7: joint_1"),
        ([0.1] * 14, "14 values, not 7"),
        ([5.0, 70.0, 60.0, 0.0, 0.0, 0.0, 1.0], "joint_1 is 5, outside"),
        ([0.1] * 6 + [float("nan")], "gripper is nan, outside 0.000 … 1.000"),
    ],
)
def test_a_reset_pose_that_the_robot_cannot_take_is_refused_at_once(tmp_path, pose, says):
    with pytest.raises(ConfigError, match=says):
        YamEnv(YamEnvConfig(robot=robot(tmp_path), reset_pose=pose))


@pytest.mark.parametrize(
    "fields, says",
    [
        ({}, "there are top, wrist_left, wrist_right, front, overview$"),  # the scene's, too
        ({"cameras": {}, "interface": "socketcan"}, "there are none$"),
    ],
)
def test_a_render_camera_that_is_not_there_is_refused_at_once(tmp_path, fields, says):
    config = YamEnvConfig(robot=robot(tmp_path, **fields), render_camera="attic")
    with pytest.raises(ConfigError, match=f"env.render_camera: there is no camera 'attic'; {says}"):
        YamEnv(config)


def test_a_camera_on_an_arm_that_is_not_in_lock_step_is_none(tmp_path):
    with pytest.raises(ConfigError, match="no camera 'wrist_right'; there are top, wrist_left, front, overview$"):
        YamEnv(YamEnvConfig(robot=robot(tmp_path), lockstep=True, render_camera="wrist_right"))


def test_real_arms_without_cameras_have_black_videos(tmp_path):
    """`lerobot-eval` asks for the first picture when the arms have moved and somebody has laid out the scene."""
    env = YamEnv(YamEnvConfig(robot=YamFollowerConfig(channel="can0", calibration_dir=tmp_path), success="operator"))
    assert env.render().shape == (240, 320, 3) and not env.render().any()


def test_a_part_that_stops_with_a_fault_ends_the_episode_without_success(lockstep, caplog):
    observation, _ = lockstep.reset(seed=3)
    rig, _ = lockstep.lockstep_task()
    rig.cut_torque("follower_left")
    for _ in range(30):
        seen, reward, terminated, truncated, info = lockstep.step(observation["agent_pos"])
        if terminated:
            break
    assert (reward, terminated, truncated, info) == (0.0, True, False, {"is_success": False})
    assert lockstep.observation_space.contains(seen)
    assert "the episode has failed: follower (follower_left)" in caplog.text
    lockstep.reset(seed=4)
    *_, terminated, _, _ = lockstep.step(observation["agent_pos"])
    assert not terminated
