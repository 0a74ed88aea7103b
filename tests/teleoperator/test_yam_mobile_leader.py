"""The teleoperator yam_mobile_leader with the robot yam_mobile, in lock-step with the rig."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_follower import FollowerArmConfig
from lerobot_robot_yam.config_yam_mobile import MobileBaseConfig, YamMobileConfig
from lerobot_robot_yam.errors import ConfigError, LifeCycleError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.yam_mobile import YamMobile
from lerobot_teleoperator_yam.config_yam_mobile_leader import YamMobileLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from lerobot_teleoperator_yam.yam_mobile_leader import YamMobileLeader
from tests.support.in_step import Together
from tests.support.virtual_pad import VirtualPad

SIDES = ("left", "right")
VELOCITY = ["x.vel", "y.vel", "theta.vel"]
POSE = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def rig():
    arms = [f"{kind}_{side}" for kind in ("follower", "leader") for side in SIDES]
    with contextlib.closing(LockstepRig("mobile_tables", arms=arms)) as rig:
        yield rig


@pytest.fixture
def pad():
    pad = VirtualPad()
    yield pad
    pad.unplug()


def leader_config(calibration_dir, rig_name="none", arms=None, **options):
    wire = {"interface": "yam_lockstep", "can_options": {"rig": rig_name}, "gravity_factor": [1.0] * 6} | (arms or {})
    leaders = {
        f"{side}_arm_config": LeaderArmConfig(
            channel=f"leader_{side}", **wire | ({"follower": f"follower_{side}"} if rig_name != "none" else {})
        )
        for side in SIDES
    }
    return YamMobileLeaderConfig(calibration_dir=calibration_dir, expo=0.0, **leaders, **options)


class Pair:
    """A mobile robot and its leaders, and LeRobot's loop over both."""

    def __init__(self, rig, calibration_dir, **options):
        self.rig = rig
        wire = {"interface": "yam_lockstep", "can_options": {"rig": rig.name}}
        followers = {
            f"{side}_arm_config": FollowerArmConfig(
                channel=f"follower_{side}", gripper_stops_rad=[3.251, -3.301], gravity_factor=[1.0] * 6, **wire
            )
            for side in SIDES
        }
        base = MobileBaseConfig(channel="base", **wire)
        self.robot = YamMobile(
            YamMobileConfig(calibration_dir=calibration_dir, base_config=base, isolation=Together, **followers)
        )
        config = leader_config(calibration_dir, rig.name, isolation=Together, **options)
        self.teleop = YamMobileLeader(config)

    def __enter__(self):
        self.teleop.connect()
        self.robot.connect()
        return self

    def __exit__(self, *_):
        for device in (self.robot, self.teleop):
            device._arms.discard()  # its world just ends
            device.disconnect()

    def run(self, seconds):
        for _ in range(round(seconds * 30)):
            self.robot.get_observation()
            action = self.teleop.get_action()
            self.robot.send_action(action)
            self.robot.clock.sleep(1 / 30)
        return action

    def base(self):
        return self.robot._base.client.observe().body_twist

    def follower(self, side):
        return np.array(self.rig.joints(f"follower_{side}")["q"][:6])


def test_leaders_lead_the_arms_and_the_pad_the_base(rig, pad, tmp_path):
    with Pair(rig, tmp_path) as pair:
        assert list(pair.teleop.action_features) == list(pair.robot.action_features) == list(pair.teleop.get_action())
        for side in SIDES:
            rig.lift(f"leader_{side}", POSE.tolist(), 1.0)
        pair.run(1.5)
        pad.push("lefty", 1.0)  # away from the table
        action = pair.run(2.0)
        assert action["x.vel"] == pytest.approx(-0.5) and pair.base()[0] < -0.3
        for side in SIDES:
            assert pair.follower(side) == pytest.approx(POSE, abs=0.1)
        assert all(state.coupled for state in pair.robot._arms.newest())  # the arms follow at loop rate all the same
        pad.unplug()
        pair.run(1.0 / 30 + 0.5 / 0.25 + 0.3)
        assert pair.base() == pytest.approx(np.zeros(3), abs=0.02)
        assert {state.mode for state in pair.robot._arms.newest()} == {Mode.TRACK}


@contextlib.contextmanager
def leaders(calibration_dir, **options):
    """Leaders that float at POSE, of a rig with nothing else."""
    channels = [f"leader_{side}" for side in SIDES]
    with contextlib.closing(LockstepRig(arms=channels)) as rig:
        config = leader_config(calibration_dir, **options)
        for side in SIDES:
            getattr(config, f"{side}_arm_config").can_options = {"rig": rig.name}
        config.isolation = "lockstep"
        device = YamMobileLeader(config)
        device.connect()
        try:
            for channel in channels:
                rig.lift(channel, POSE.tolist(), 1.0)
            device._arms.clock.sleep(1.5)
            device.get_action()
            yield rig, device
        finally:
            device._arms.discard()
            device.disconnect()


TURNED = POSE + [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]  # of the first joint: the handle goes to the left, and turns


def moved(rig, device, q, seconds=0.5):
    """The action after the left leader's way to q."""
    rig.lift("leader_left", q.tolist(), seconds)
    for _ in range(round((seconds + 0.3) / 0.1)):  # LeRobot asks all the time
        device._arms.clock.sleep(0.1)
        action = device.get_action()
    return action


def of_left(action):
    return {key: value for key, value in action.items() if key.startswith("left_")}


def test_a_handle_is_a_stick_while_its_button_is_held(tmp_path):
    with leaders(tmp_path, drive="left", rail=True) as (rig, device):
        before = device.get_action()
        assert not any(before[key] for key in (*VELOCITY, "height.vel"))
        rig.press("leader_left", "sync", 5.0)
        device._arms.clock.sleep(0.1)
        device.get_action()
        action = moved(rig, device, TURNED)
        assert action["y.vel"] > 0.3 and action["theta.vel"] > 30.0
        assert of_left(action) == pytest.approx(of_left(before), abs=0.01)  # its follower stays
        action = moved(rig, device, POSE + [0.0, -0.3, 0.0, 0.0, 0.0, 0.0])
        assert action["x.vel"] < -0.1 and action["theta.vel"] == pytest.approx(0.0, abs=1.0)
        rig.fault("leader_left", None, "handle_silent")
        device._arms.clock.sleep(0.5)
        assert not any(device.get_action()[key] for key in VELOCITY)


def test_a_handle_that_nobody_asked_for_long_has_to_be_pressed_anew(tmp_path):
    with leaders(tmp_path, drive="left") as (rig, device):
        rig.press("leader_left", "sync", 5.0)
        device._arms.clock.sleep(0.1)
        device.get_action()
        assert moved(rig, device, TURNED)["y.vel"] > 0.3
        device._arms.clock.sleep(0.8)  # LeRobot saves an episode; a stop in it would go unnoticed
        assert moved(rig, device, POSE)["y.vel"] == 0.0


def test_a_handle_leads_again_when_its_button_is_let_go(tmp_path):
    with leaders(tmp_path, drive="left") as (rig, device):
        rig.press("leader_left", "sync", 1.0)
        device._arms.clock.sleep(0.1)
        device.get_action()
        assert moved(rig, device, TURNED)["y.vel"] > 0.3
        device._arms.clock.sleep(0.3)
        action = device.get_action()
        assert [action[key] for key in VELOCITY] == [0.0, 0.0, 0.0]
        assert action["left_joint_1.pos"] == pytest.approx(TURNED[0], abs=0.03)
        assert moved(rig, device, POSE)["y.vel"] == 0.0  # without the button it drives nothing


@pytest.mark.long
def test_the_rigs_operator_drives_by_what_it_asks(rig, tmp_path):
    with Pair(rig, tmp_path, drive="rig") as pair:
        assert pair.run(0.1)["x.vel"] == 0.0
        for _ in range(10):
            rig.ask_drive([-0.2, 0.0, 0.3])
            action = pair.run(0.1)
        assert [action["x.vel"], action["theta.vel"]] == pytest.approx([-0.2, np.degrees(0.3)])
        assert pair.base()[0] < -0.1 and pair.base()[2] > 0.15
        pair.run(0.4)  # nobody asks any more
        assert pair.run(0.1)["x.vel"] == 0.0


@pytest.mark.long
def test_a_handle_drives_while_its_button_is_held_and_its_follower_stays(rig, tmp_path):
    with Pair(rig, tmp_path, drive="left") as pair:
        for side in SIDES:
            rig.lift(f"leader_{side}", POSE.tolist(), 1.0)
        pair.run(2.0)
        there = pair.follower("left")
        rig.press("leader_left", "sync", 3.0)
        pair.run(0.3)
        for side in SIDES:
            rig.lift(f"leader_{side}", TURNED.tolist(), 0.5)
        action = pair.run(1.7)
        assert action["y.vel"] > 0.3 and action["theta.vel"] > 30.0
        assert pair.base()[2] > 0.3
        assert pair.follower("left") == pytest.approx(there, abs=0.05)
        assert pair.follower("right") == pytest.approx(TURNED, abs=0.1)
        action = pair.run(4.0)  # the button is up
        assert [action[key] for key in VELOCITY] == [0.0, 0.0, 0.0] and pair.base() == pytest.approx(
            np.zeros(3), abs=0.02
        )
        assert pair.follower("left") == pytest.approx(TURNED, abs=0.1)


def test_a_pushed_stick_energises_no_leader(rig, pad, tmp_path):
    pad.push("rightx", 0.5)
    pair = Pair(rig, tmp_path)
    with pytest.raises(LifeCycleError, match="stick of theta"):
        pair.teleop.connect()
    assert not pair.teleop.is_connected
    assert not any(m["enabled"] for m in rig.state()["arms"]["leader_left"]["motors"].values())


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"drive": "both"}, "drive is pad, left, right or rig"),
        ({"drive": "rig", "arms": {"interface": "socketcan"}}, "drive: rig is for leaders of the virtual rig"),
        ({"drive": "left", "arms": {"gripper": "no_gripper"}}, "the left leader has no teaching handle"),
        ({"drive": "left", "drive_button": "bottom", "buttons": "record"}, "drive_button and buttons"),
        ({"drive": "right", "arms": {"estop_button": "top"}}, "drive_button and estop_button"),
        ({"speed": [9.0, 0.5, 90.0]}, "speed is three numbers"),
        ({"dead_zone": 1.0}, "dead_zone is 0 to 0.5"),
    ],
    ids=str,
)
def test_options_that_are_refused(tmp_path, options, why):
    with pytest.raises(ConfigError, match=why):
        leader_config(tmp_path, **options)
