"""A mobile base as a LeRobot robot, alone and with arms, over CAN frames, in lock-step with its rig."""

import contextlib
import math
from types import SimpleNamespace

import numpy as np
import pytest
from lerobot.robots import make_robot_from_config
from lerobot.rollout.strategies import dagger

from lerobot_robot_yam.config_yam_follower import FollowerArmConfig
from lerobot_robot_yam.config_yam_mobile import MobileBaseConfig, YamBaseRobotConfig, YamMobileConfig
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError, MotorError
from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from tests.mobile.rails import Rail

VELOCITY = ["x.vel", "y.vel", "theta.vel"]
BASE = {"channel": "base", "interface": "yam_lockstep"}


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("mobile")) as rig:
        yield rig


@contextlib.contextmanager
def connected(rig, tmp_path, **options):
    config = YamBaseRobotConfig(
        **BASE, can_options={"rig": rig.name}, isolation="lockstep", calibration_dir=tmp_path, **options
    )
    robot = make_robot_from_config(config)
    robot.connect()
    try:
        yield robot
    finally:
        robot.disconnect()


def drive(robot, x=0.0, y=0.0, theta=0.0, seconds=1.0):
    for _ in range(round(seconds * 30)):
        robot.get_observation()
        sent = robot.send_action(dict(zip(VELOCITY, (x, y, theta), strict=True)))
        robot.clock.sleep(1 / 30)
    return sent


def truth(rig):
    return np.array(rig.state()["base"]["pose"])


def test_it_drives_as_actions_say_and_brakes_when_they_end(rig, tmp_path):
    with connected(rig, tmp_path) as robot:
        assert list(robot.action_features) == list(robot.observation_features) == VELOCITY and robot.is_calibrated
        assert drive(robot, 0.3, 0.0, 30.0, 2.0) == {"x.vel": 0.3, "y.vel": 0.0, "theta.vel": pytest.approx(30.0)}
        seen = robot.get_observation()
        assert list(seen) == VELOCITY
        assert seen["x.vel"] == pytest.approx(0.3, abs=0.02) and seen["theta.vel"] == pytest.approx(30.0, abs=1.0)
        robot.clock.sleep(0.25 + 0.3 / 0.25 + 0.2)
        assert [*robot.get_observation().values()] == pytest.approx([0.0] * 3, abs=0.01)
        there = truth(rig)
        robot.clock.sleep(0.5)
        assert truth(rig) == pytest.approx(there, abs=1e-3)
    assert not robot.is_connected and not any(m["enabled"] for m in rig.state()["base"]["motors"].values())


def test_odometry_and_wheels_are_observed_on_request(rig, tmp_path):
    with connected(rig, tmp_path, observe_odometry=True, observe_wheels=True) as robot:
        drive(robot, 0.3, 0.0, 30.0, 2.0)
        seen = robot.get_observation()
        assert list(seen) == list(robot.observation_features)
        assert all(key.endswith((".pos", ".vel")) for key in seen)  # what rollout keeps
        x, y, theta = truth(rig)
        assert [seen["x.pos"], seen["y.pos"]] == pytest.approx([x, y], abs=0.02)
        assert seen["theta.pos"] == pytest.approx(math.degrees(theta), abs=5.0) and theta > 0.5  # the wheels slip
        assert seen["front_left_drive.vel"] > 3.0 and abs(seen["rear_left_steer.pos"]) > 0.1


def test_too_fast_is_slowed_down_in_its_direction_and_said(rig, tmp_path):
    with connected(rig, tmp_path) as robot:
        assert [*drive(robot, 2.0, 1.0, 0.0, 0.1).values()] == pytest.approx([0.5, 0.25, 0.0])


@pytest.mark.parametrize(
    "wrong",
    [
        {"x.vel": 0.1, "y.vel": 0.0},
        {"x.vel": 0.1, "y.vel": 0.0, "theta.vel": 0.0, "height.vel": 0.0},
        {"x.vel": 0.1, "y.vel": math.nan, "theta.vel": 0.0},
        {"x.vel": 0.1, "y.vel": "fast", "theta.vel": 0.0},
        [0.1, 0.0, 0.0],
    ],
    ids=["missing", "unknown", "nan", "text", "list"],
)
def test_a_wrong_action_moves_nothing(rig, tmp_path, wrong):
    with connected(rig, tmp_path) as robot:
        with pytest.raises(ActionError):
            robot.send_action(wrong)
        robot.clock.sleep(0.2)
        assert truth(rig) == pytest.approx([0.0] * 3, abs=1e-3)


@pytest.mark.long
def test_a_silent_motor_is_named_and_the_base_drives_again_after_rearm(rig, tmp_path):
    with connected(rig, tmp_path) as robot:
        drive(robot, 0.3)
        rig.fault("base", "rear_left_drive", "silent", True)
        robot.clock.sleep(1.0)
        with pytest.raises(MotorError, match="rear_left_drive"):
            robot.get_observation()
        with pytest.raises(MotorError, match="rear_left_drive"):
            robot.send_action(dict.fromkeys(VELOCITY, 0.1))
        rig.fault("base", "rear_left_drive", "silent", False)
        robot.rearm()
        drive(robot, 0.2, seconds=1.2)
        assert robot.get_observation()["x.vel"] == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"channel": ""}, "channel is empty"),
        ({"velocity_limit": [2.0, 0.5, 1.0]}, "velocity limits"),
        ({"observe_wheels": None}, "observe_wheels takes true or false"),
    ],
    ids=["channel", "limit", "switch"],
)
def test_a_wrong_config_is_refused(tmp_path, options, says):
    with pytest.raises(ConfigError, match=says):
        make_robot_from_config(YamBaseRobotConfig(**BASE | options, calibration_dir=tmp_path))


def in_dagger(phase, call):
    """Call a function as LeRobot's strategy does in a phase: from its `run`, in its file."""
    code = "def run(self, call):\n    return call()\n"
    names = {}
    exec(compile(code, dagger.__file__, "exec"), names)
    return names["run"](SimpleNamespace(_events=SimpleNamespace(phase=phase)), call)


def test_the_base_stands_while_a_rollout_with_corrections_is_paused(rig, tmp_path):
    with connected(rig, tmp_path) as robot:
        action = {"x.vel": 0.3, "y.vel": 0.0, "theta.vel": 0.0}
        assert in_dagger(dagger.DAggerPhase.AUTONOMOUS, lambda: go(robot, action, 0.8))["x.vel"] == 0.3
        assert in_dagger(dagger.DAggerPhase.PAUSED, lambda: go(robot, action, 1.0))["x.vel"] == 0.0
        assert robot.get_observation()["x.vel"] == pytest.approx(0.0, abs=0.01)
        assert in_dagger(dagger.DAggerPhase.CORRECTING, lambda: robot.send_action(action))["x.vel"] == 0.3


@contextlib.contextmanager
def railed(rail, tmp_path, calibrate=True, path=True, **options):
    """A base with a rail; path: whether its file is where the test has it."""
    config = RailConfig(io="sim", stroke_m=rail.stroke_m, calibration_path=str(rail.path) if path else None)
    wire = {"can_options": {"rig": rail.rig.name}, "isolation": "lockstep", "calibration_dir": tmp_path / "kept"}
    robot = make_robot_from_config(YamBaseRobotConfig(**BASE, **wire, rail=config, **options))
    try:
        robot.connect(calibrate)
        yield robot
    finally:
        robot.disconnect()


def test_a_rail_is_driven_by_velocity_or_height(tmp_path):
    rail = Rail(tmp_path, height_m=0.2, stroke_m=0.5)
    with contextlib.closing(rail.rig):
        with railed(rail, tmp_path) as robot:
            assert list(robot.action_features) == [*VELOCITY, "height.vel"] and robot.is_calibrated
            assert list(robot.observation_features) == [*VELOCITY, "height.vel", "height.pos"]
            sent = go(robot, dict.fromkeys(VELOCITY, 0.0) | {"height.vel": 9.0}, 0.1)
            assert sent["height.vel"] == 0.5
            go(robot, dict.fromkeys(VELOCITY, 0.0) | {"height.vel": 0.1}, 1.0)
            seen = robot.get_observation()
            assert seen["height.vel"] == pytest.approx(0.1, abs=0.02)
            assert seen["height.pos"] == pytest.approx(rail.height_m, abs=2e-3) and rail.height_m > 0.28
            robot.clock.sleep(0.6)  # LeRobot saves an episode
            assert robot.get_observation()["height.vel"] == pytest.approx(0.0, abs=5e-3)
        with railed(rail, tmp_path, rail_action="pos") as robot:
            keys = [*VELOCITY, "height.pos"]
            assert list(robot.action_features) == list(robot.observation_features) == keys
            assert go(robot, dict.fromkeys(VELOCITY, 0.0) | {"height.pos": 0.25}, 1.5)["height.pos"] == 0.25
            assert rail.height_m == pytest.approx(0.25, abs=5e-3)
            with pytest.raises(ActionError, match=r"height.pos is nan"):
                robot.send_action(dict.fromkeys(VELOCITY, 0.1) | {"height.pos": math.nan})


def test_a_rail_is_homed_by_calibrate_alone(tmp_path):
    rail = Rail(tmp_path, height_m=0.05, stroke_m=0.1, known=False)
    with contextlib.closing(rail.rig):
        with pytest.raises(LifeCycleError, match="run lerobot-calibrate"), railed(rail, tmp_path, path=False):
            pass
        assert not rail.enabled and rail.height_m == pytest.approx(0.05, abs=2e-3)
        with railed(rail, tmp_path, calibrate=False, path=False) as robot:
            assert not robot.is_calibrated
            with pytest.raises(LifeCycleError, match="not homed"):
                robot.send_action(dict.fromkeys([*VELOCITY, "height.vel"], 0.0))
            robot.calibrate()
            assert robot.is_calibrated
            assert robot.get_observation()["height.pos"] == pytest.approx(rail.height_m, abs=2e-3)
        assert (tmp_path / "kept" / "yam" / "base_rail.json").is_file()
        with railed(rail, tmp_path, path=False) as robot:  # it stands where its brake has taken it
            assert robot.is_calibrated


NAMES = [*(f"joint_{number}" for number in range(1, 7)), "gripper"]
ARMS = [f"{side}_{name}.pos" for side in ("left", "right") for name in NAMES]


@pytest.fixture
def tables():
    with contextlib.closing(LockstepRig("mobile_tables", arms=["follower_left", "follower_right"])) as rig:
        yield rig


def mobile_config(rig_name, tmp_path, base=None, **options):
    wire = {"interface": "yam_lockstep", "can_options": {"rig": rig_name}}
    arms = {
        f"{side}_arm_config": FollowerArmConfig(
            **wire, channel=f"follower_{side}", gripper_stops_rad=[3.251, -3.301], gravity_factor=[1.0] * 6
        )
        for side in ("left", "right")
    }
    base = MobileBaseConfig(**wire, **{"channel": "base"} | (base or {}))
    return YamMobileConfig(**arms, base_config=base, isolation="lockstep", calibration_dir=tmp_path, **options)


@contextlib.contextmanager
def mobile(rig, tmp_path, **options):
    robot = make_robot_from_config(mobile_config(rig.name, tmp_path, **options))
    robot.connect()
    try:
        yield robot
    finally:
        robot.disconnect()


def go(robot, action, seconds):
    for _ in range(round(seconds * 30)):
        robot.get_observation()
        sent = robot.send_action(action)
        robot.clock.sleep(1 / 30)
    return sent


def arms_of(values):
    return {key: values[key] for key in ARMS}


def test_arms_and_base_move_by_one_action_and_stop_together(tables, tmp_path):
    with mobile(tables, tmp_path, observe_velocity=True, observe_odometry=True) as robot:
        assert list(robot.action_features) == [*ARMS, *VELOCITY]
        state = list(robot.observation_features)
        assert state[: len(ARMS) + 3] == [*ARMS, *VELOCITY] and state[-3:] == ["x.pos", "y.pos", "theta.pos"]
        assert state == robot.config.state_keys() and set(state) == set(robot.get_observation())
        begin, at = robot.get_observation(), truth(tables)
        target = arms_of(begin) | {"left_joint_1.pos": begin["left_joint_1.pos"] + 0.3}
        sent = go(robot, target | {"x.vel": -0.2, "y.vel": 0.0, "theta.vel": 10.0}, 2.0)
        seen = robot.get_observation()
        assert sent["left_joint_1.pos"] == pytest.approx(target["left_joint_1.pos"]) and sent["x.vel"] == -0.2
        assert seen["left_joint_1.pos"] == pytest.approx(target["left_joint_1.pos"], abs=0.05)
        assert seen["x.vel"] == pytest.approx(-0.2, abs=0.03) and seen["theta.vel"] == pytest.approx(10.0, abs=2.0)
        assert truth(tables)[0] < at[0] - 0.15
        robot.clock.sleep(0.25 + 0.2 / 0.25 + 0.2)  # LeRobot saves an episode
        seen = robot.get_observation()
        assert [seen[key] for key in VELOCITY] == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
    motors = tables.state()["base"]["motors"] | tables.state()["arms"]["follower_left"]["motors"]
    assert not any(motor["enabled"] for motor in motors.values())


def test_a_mistake_in_either_part_moves_neither(tables, tmp_path):
    with mobile(tables, tmp_path) as robot:
        begin, at = robot.get_observation(), truth(tables)
        wrong = [
            ({"theta.vel": math.nan}, "theta.vel"),
            ({"right_gripper.pos": math.inf}, "right_gripper"),
            ({"height.vel": 0.0}, "height.vel"),
            ({f"left_joint_{n}.pos": 30.0 for n in (1, 2, 3)}, "degrees"),
        ]
        for mistake, says in wrong:
            moves = arms_of(begin) | {"left_joint_1.pos": begin["left_joint_1.pos"] + 0.3, "y.vel": 0.0}
            with pytest.raises(ActionError, match=says):
                robot.send_action(moves | {"x.vel": -0.3, "theta.vel": 0.0} | mistake)
        with pytest.raises(ActionError, match=r"lacks \['x.vel', 'y.vel', 'theta.vel'\]"):
            robot.send_action(arms_of(begin) | {"left_gripper.pos": 1.0, "y": 0.0})
        robot.clock.sleep(0.5)
        assert arms_of(robot.get_observation()) == pytest.approx(arms_of(begin), abs=0.02)
        assert truth(tables) == pytest.approx(at, abs=1e-3)


def test_what_rollout_sends_at_its_end_moves_the_arms_only(tables, tmp_path):
    with mobile(tables, tmp_path, observe_odometry=True) as robot:
        begin = {key: value for key, value in robot.get_observation().items() if key.endswith(".pos")}
        back = begin | {"left_joint_1.pos": begin["left_joint_1.pos"] + 0.2, "x.pos": 3.0}
        at = truth(tables)
        sent = go(robot, back, 1.0)
        assert [sent[key] for key in VELOCITY] == [0.0, 0.0, 0.0]
        assert robot.get_observation()["left_joint_1.pos"] == pytest.approx(back["left_joint_1.pos"], abs=0.05)
        assert truth(tables) == pytest.approx(at, abs=2e-3)


@pytest.mark.long
def test_the_base_stands_while_lerobot_repeats_its_last_action(tables, tmp_path):
    with mobile(tables, tmp_path) as robot:
        action = arms_of(robot.get_observation()) | {"x.vel": -0.2, "y.vel": 0.0, "theta.vel": 0.0}
        go(robot, action, 1.0)
        robot._arms.pause_followers()  # what a leader does that LeRobot holds
        sent = go(robot, action, 1.5)
        assert sent["x.vel"] == 0.0 and robot.get_observation()["x.vel"] == pytest.approx(0.0, abs=0.01)
        assert go(robot, action | {"x.vel": -0.1}, 1.0)["x.vel"] == -0.1
        assert robot.get_observation()["x.vel"] == pytest.approx(-0.1, abs=0.03)


def test_a_fault_of_one_part_stops_the_other(tables, tmp_path):
    with mobile(tables, tmp_path) as robot:
        action = arms_of(robot.get_observation()) | {"x.vel": -0.2, "y.vel": 0.0, "theta.vel": 0.0}
        go(robot, action, 1.0)
        tables.fault("follower_left", "joint_2", "silent", True)
        with pytest.raises(MotorError, match="joint_2"):
            go(robot, action, 2.0)
        robot.clock.sleep(1.0)
        assert robot._base.client.observe().body_twist == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
        tables.fault("follower_left", "joint_2", "silent", False)
        robot.rearm()
        go(robot, action, 1.0)
        tables.fault("base", "front_left_drive", "silent", True)
        with pytest.raises(MotorError, match="front_left_drive"):
            go(robot, action, 2.0)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"base": {"channel": "follower_left"}}, "different names and channels"),
        ({"base": {"rate_hz": 100.0}}, "same rate_hz"),
        ({"base": {"acceleration_limit": [9.0, 1.0, 1.0]}}, "acceleration limits"),
        ({"observe_odometry": None}, "observe_odometry takes true or false"),
    ],
    ids=["channel", "rate", "limit", "switch"],
)
def test_a_wrong_config_of_a_mobile_robot_is_refused(tmp_path, options, says):
    with pytest.raises(ConfigError, match=says):
        mobile_config("no-rig", tmp_path, **options)
