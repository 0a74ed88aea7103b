"""A follower and its leader as LeRobot's RL stack asks them."""

import time

import draccus
import numpy as np
import pytest
import torch
from lerobot.processor import TransitionKey
from lerobot.teleoperators.utils import TeleopEvents

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.commands.model_file import main as write_model
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.rig.client.rig_control import running_rig
from tests.face.devices.test_lerobot_contract import BiYamFollower, follower_config
from tests.face.devices.test_pairing import follower, leader
from tests.support.paths import ROOT
from tests.support.tiers import spread

pytestmark = pytest.mark.alone

BUTTONS = {"correct": "bottom", "success": "top"}
IN_RIG = {"top": "sync", "bottom": "record"}
RESET_DEG = [0.0, 60.0, 60.0, -70.0, 0.0, 0.0, 0.2]


@pytest.fixture(scope="module")
def shared_rig():
    with running_rig(arms=["follower_left", "leader_left"]) as rig:
        yield rig


@pytest.fixture(scope="module")
def pair(shared_rig, tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibration")
    teleop = leader(shared_rig, folder, action_space="delta", buttons=BUTTONS)
    robot = follower(shared_rig, folder, use_degrees=True)
    teleop.connect()
    try:
        robot.connect()
        teleop.get_teleop_events()  # from now on it watches
        yield robot, teleop
    finally:
        robot.disconnect()
        teleop.disconnect()


def ask_until(teleop, event, within_s=2.0):
    """Ask as often as LeRobot does until an event comes; all answers."""
    answers, until_s = [], time.monotonic() + within_s
    while time.monotonic() < until_s:
        answers.append(teleop.get_teleop_events())
        if answers[-1][event]:
            return answers
        time.sleep(0.1)
    pytest.fail(f"no {event}: {answers}")


def test_the_bus_reads_what_the_robot_observes(pair):
    robot, _ = pair
    observed = robot.get_observation()
    assert list(robot.bus.motors) == [key.removesuffix(".pos") for key in observed]
    assert list(robot.bus.sync_read("Present_Position").values()) == pytest.approx(list(observed.values()), abs=0.5)
    with pytest.raises(ActionError, match="no Present_Current; leave add_current_to_observation off"):
        robot.bus.sync_read("Present_Current")


def test_a_goal_that_is_written_is_reached_however_far_it_is(pair):
    """LeRobot's reset writes a way in 0.75 s, and then nothing."""
    robot, _ = pair
    start = robot.bus.sync_read("Present_Position")
    for share in np.linspace(0.0, 1.0, 10):
        way = {name: (1.0 - share) * start[name] + share * to for name, to in zip(start, RESET_DEG, strict=True)}
        robot.bus.sync_write("Goal_Position", way)
    time.sleep(0.3)
    there = list(robot.bus.sync_read("Present_Position").values())
    assert there[:6] == pytest.approx(RESET_DEG[:6], abs=1.0) and there[6] == pytest.approx(RESET_DEG[6], abs=0.05)
    with pytest.raises(ActionError, match="Present_Position"):
        robot.bus.sync_write("Present_Position", start)


def test_buttons_are_told_once_and_take_over(pair, shared_rig):
    _, teleop = pair
    assert not any(teleop.get_teleop_events().values())
    shared_rig.press("leader_left", IN_RIG["top"], 0.05)  # shorter than a frame of LeRobot's
    (*_, told) = ask_until(teleop, TeleopEvents.SUCCESS)
    assert not told[TeleopEvents.IS_INTERVENTION] and not told[TeleopEvents.TERMINATE_EPISODE]
    assert not any(teleop.get_teleop_events().values())
    shared_rig.press("leader_left", IN_RIG["bottom"], 0.05)
    ask_until(teleop, TeleopEvents.IS_INTERVENTION)
    assert list(teleop.get_action().values()) == [0.0, 0.0, 0.0, 2.0]  # no step, and the gripper goes on closing
    shared_rig.press("leader_left", IN_RIG["bottom"], 0.05)
    time.sleep(0.2)
    assert not teleop.get_teleop_events()[TeleopEvents.IS_INTERVENTION]


@pytest.mark.long
def test_the_stock_environment_takes_the_policy_and_the_person(pair, shared_rig, tmp_path):
    """Its own steps, from the shipped config, but for the waits of its reset."""
    pytest.importorskip("placo", reason='LeRobot\'s kinematics needs the extra: pip install -e ".[hil-serl]"')
    from lerobot.rl import gym_manipulator as stock

    robot, teleop = pair
    assert write_model(["--format=urdf", str(tmp_path / "yam.urdf")]) == 0
    config = draccus.parse(stock.GymManipulatorConfig, ROOT / "configs" / "sim" / "hil_serl.yaml", []).env
    config.processor.inverse_kinematics.urdf_path = str(tmp_path / "yam.urdf")
    env = stock.RobotEnv(robot, use_gripper=True, reset_pose=[*RESET_DEG[:6], 1.0], reset_time_s=0.0)
    processors = stock.make_processors(env, teleop, config)
    transition = stock.reset_and_build_transition(env, *processors)

    def steps(action, count):
        nonlocal transition
        for _ in range(count):
            transition = stock.step_env_and_process_transition(env, transition, torch.tensor(action), *processors)
            time.sleep(1.0 / config.fps)
        return transition

    def tool(channel):
        q = np.array(shared_rig.state()["arms"][channel]["q"])
        return YamKinematics("yam", "linear_4310").fk(q)[:3, 3]

    start = tool("follower_left")
    steps([[0.0, 0.5, 0.0, 2.0]], 10)  # a batch of one, as the actor's policy gives
    time.sleep(0.3)
    np.testing.assert_allclose(tool("follower_left") - start, [0.0, 0.1, 0.0], atol=0.015)
    assert shared_rig.state()["arms"]["follower_left"]["opening"] < 0.05

    shared_rig.press("leader_left", IN_RIG["bottom"], 0.05)
    steps([0.0, 0.0, 0.0, 1.0], 3)
    start, leader = tool("follower_left"), tool("leader_left")
    shared_rig.lift("leader_left", [-0.2, 0.6, 0.6, -0.1, 0.0, 0.0], 1.0)
    last = steps([0.0, -1.0, 0.0, 1.0], 20)
    way = tool("leader_left") - leader
    assert np.linalg.norm(way) > 0.1 and last[TransitionKey.INFO][TeleopEvents.IS_INTERVENTION]
    np.testing.assert_allclose(tool("follower_left") - start, way, atol=0.015)
    shared_rig.press("leader_left", IN_RIG["top"], 0.05)
    last = next(done for _ in range(20) if (done := steps([0.0, 0.0, 0.0, 1.0], 1))[TransitionKey.DONE])
    assert last[TransitionKey.REWARD] == 1.0


@pytest.mark.parametrize("options", spread([{}, {"action_space": "ee", "use_degrees": True}], 0))
def test_followers_that_the_stack_would_misread_are_refused(shared_rig, tmp_path, options):
    with pytest.raises(ConfigError, match="computes in degrees; set use_degrees"):
        follower(shared_rig, tmp_path, **options).bus.motors  # noqa: B018
    with pytest.raises(ConfigError, match="drives one arm with a gripper"):
        BiYamFollower(follower_config("none", tmp_path, use_degrees=True)).bus.motors  # noqa: B018
