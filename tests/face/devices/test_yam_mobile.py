"""A mobile base as a LeRobot robot, over CAN frames, in lock-step with its rig."""

import contextlib
import math

import numpy as np
import pytest
from lerobot.robots import make_robot_from_config

from lerobot_robot_yam.config_yam_mobile import YamBaseRobotConfig
from lerobot_robot_yam.errors import ActionError, ConfigError, MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig

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
        assert drive(robot, 0.3, 0.0, 30.0, 3.0) == {"x.vel": 0.3, "y.vel": 0.0, "theta.vel": pytest.approx(30.0)}
        seen = robot.get_observation()
        assert list(seen) == VELOCITY
        assert seen["x.vel"] == pytest.approx(0.3, abs=0.02) and seen["theta.vel"] == pytest.approx(30.0, abs=1.0)
        robot.clock.sleep(0.25 + 0.3 / 0.25 + 0.2)
        assert [*robot.get_observation().values()] == pytest.approx([0.0] * 3, abs=0.01)
        there = truth(rig)
        robot.clock.sleep(1.0)
        assert truth(rig) == pytest.approx(there, abs=1e-3)
    assert not robot.is_connected and not any(m["enabled"] for m in rig.state()["base"]["motors"].values())


def test_odometry_and_wheels_are_observed_on_request(rig, tmp_path):
    with connected(rig, tmp_path, observe_odometry=True, observe_wheels=True) as robot:
        drive(robot, 0.3, 0.0, 30.0, 3.0)
        seen = robot.get_observation()
        assert list(seen) == list(robot.observation_features)
        assert all(key.endswith((".pos", ".vel")) for key in seen)  # what rollout keeps
        x, y, theta = truth(rig)
        assert [seen["x.pos"], seen["y.pos"]] == pytest.approx([x, y], abs=0.02)
        assert seen["theta.pos"] == pytest.approx(math.degrees(theta), abs=5.0) and theta > 1.0  # the wheels slip
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
        robot.clock.sleep(0.5)
        assert truth(rig) == pytest.approx([0.0] * 3, abs=1e-3)


def test_a_silent_motor_is_named_and_the_base_drives_again_after_rearm(rig, tmp_path):
    with connected(rig, tmp_path) as robot:
        drive(robot, 0.3)
        rig.fault("base", "rear_left_drive", "silent", True)
        robot.clock.sleep(2.0)
        with pytest.raises(MotorError, match="rear_left_drive"):
            robot.get_observation()
        with pytest.raises(MotorError, match="rear_left_drive"):
            robot.send_action(dict.fromkeys(VELOCITY, 0.1))
        rig.fault("base", "rear_left_drive", "silent", False)
        robot.rearm()
        drive(robot, 0.2, seconds=2.0)
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
