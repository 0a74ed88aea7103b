"""yam_gamepad and yam_base as one LeRobot command has them, in lock-step with the rig."""

import contextlib
import math

import numpy as np
import pytest
from lerobot.robots import make_robot_from_config

from lerobot_robot_yam.config_yam_mobile import YamBaseRemoteConfig, YamBaseRobotConfig
from lerobot_robot_yam.face.devices.device_session import DeviceSession
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.yam_mobile import YamBaseRemote
from lerobot_teleoperator_yam.config_yam_gamepad import YamGamepadConfig
from lerobot_teleoperator_yam.yam_gamepad import YamGamepad
from tests.mobile.rails import Rail
from tests.support.hosted import ServedArms
from tests.support.link_in_step import LinkInStep
from tests.support.virtual_pad import VirtualPad


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("mobile")) as rig:
        yield rig


@pytest.fixture
def pad():
    pad = VirtualPad()
    yield pad
    pad.unplug()


class Pair:
    """A robot, its teleoperator, and LeRobot's loop over both."""

    def __init__(self, rig, robot, teleop):
        self.rig, self.robot, self.teleop = rig, robot, teleop

    def run(self, seconds):
        for _ in range(round(seconds * 30)):
            self.robot.get_observation()
            action = self.teleop.get_action()
            sent = self.robot.send_action(action)
            self.robot.clock.sleep(1 / 30)
        return action, sent

    @property
    def truth(self):
        return np.array(self.rig.state()["base"]["pose"])

    @classmethod
    @contextlib.contextmanager
    def connected(cls, rig, robot, calibration_dir):
        teleop = YamGamepad(YamGamepadConfig(calibration_dir=calibration_dir, expo=0.0))
        teleop.connect()
        robot.connect()
        try:
            yield cls(rig, robot, teleop)
        finally:
            robot.disconnect()
            teleop.disconnect()


@pytest.fixture
def pair(rig, pad, tmp_path):
    base = dict(channel="base", interface="yam_lockstep", can_options={"rig": rig.name}, isolation="lockstep")
    robot = make_robot_from_config(
        YamBaseRobotConfig(**base, calibration_dir=tmp_path, velocity_limit=[0.3, 0.5, 1.57])
    )
    with Pair.connected(rig, robot, tmp_path) as pair:
        yield pair


@pytest.fixture
def far_pair(rig, pad, tmp_path):
    """The base is another computer's."""
    with ServedArms(rig, "base") as served:
        config = YamBaseRemoteConfig(host=str(served.address), calibration_dir=tmp_path)
        config.runs = lambda: LinkInStep.on(served, config.hosted)
        with Pair.connected(rig, YamBaseRemote(config), tmp_path) as pair:
            yield pair


def test_sticks_drive_the_base_and_what_is_recorded_is_what_it_does(pair, pad):
    pad.push("lefty", -1.0)
    action, sent = pair.run(3.0)
    assert action == pytest.approx(sent) and action["x.vel"] == pytest.approx(0.3)  # the base's own limit
    assert pair.truth[0] > 0.6
    pad.push("lefty", 0.0)
    pair.run(2.0)
    assert abs(pair.robot.get_observation()["x.vel"]) < 0.01


def test_an_unplugged_pad_brakes_the_base_as_planned(pair, pad):
    pad.push("lefty", -1.0)
    pair.run(3.0)
    pad.unplug()
    before = pair.truth[0]
    pair.run(1.0 / 30 + 0.3 / 0.25 + 0.2)
    assert abs(pair.robot.get_observation()["x.vel"]) < 0.01
    assert pair.truth[0] - before < 0.3**2 / (2 * 0.25) + 0.05
    assert pair.robot._base.client.mode() in (Mode.HOLD, Mode.TRACK)


def test_in_the_global_frame_forward_stays_forward_while_it_turns(pair, pad):
    pair.robot._base.client.reset_odometry()
    pad.push("rightx", -1.0)
    pair.run(1.2)
    pad.push("rightx", 0.0)
    pair.run(1.5)
    turned = pair.truth[2]
    assert turned > 0.8
    pad.press("start")
    pair.run(0.1)
    before = pair.truth
    pad.push("lefty", -1.0)
    pad.push("rightx", -0.5)
    pair.run(3.0)
    x, y, theta = pair.truth - before
    assert x > 0.5 and abs(y) < 0.1 and theta > 0.5


def test_frame_and_reset_reach_a_base_that_another_computer_drives(far_pair, pad):
    pad.push("rightx", -1.0)
    far_pair.run(1.0)
    pad.push("rightx", 0.0)
    far_pair.run(1.0)
    for button in ("back", "start"):
        pad.press(button)
        far_pair.run(0.1)
    before = far_pair.truth
    assert before[2] > 0.6 and far_pair.robot._base.client.observe().pose == pytest.approx(np.zeros(3), abs=0.01)
    pad.push("lefty", -1.0)
    pad.push("rightx", -0.5)
    action, _ = far_pair.run(2.0)
    moved = far_pair.truth - before
    assert moved[2] > 0.5 and action["y.vel"] < -0.1  # forward is where it looked at the reset
    assert math.atan2(moved[1], moved[0]) == pytest.approx(before[2], abs=0.1)
    pad.press("b")
    far_pair.run(0.5)
    assert far_pair.robot._base.client.mode() is Mode.STOPPED
    EmergencyStop().release()


@pytest.mark.long
def test_a_reset_makes_the_present_heading_the_frame(pair, pad):
    pad.push("rightx", -1.0)
    pair.run(1.2)
    pad.push("rightx", 0.0)
    pair.run(1.5)
    for button in ("back", "start"):
        pad.press(button)
        pair.run(0.1)
    assert pair.robot._base.client.observe().pose == pytest.approx(np.zeros(3), abs=0.01)
    before = pair.truth
    pad.push("lefty", -1.0)
    pair.run(3.0)
    moved = pair.truth[:2] - before[:2]
    assert math.atan2(moved[1], moved[0]) == pytest.approx(before[2], abs=0.05)


def test_a_heading_that_is_no_longer_known_brakes_and_goes_back_to_the_local_frame(pair, pad, caplog):
    pad.press("start")
    pair.run(0.1)
    pad.push("lefty", -1.0)
    assert pair.teleop.get_action()["x.vel"] > 0.0
    pair.rig.fault("base", "front_left_drive", "silent", True)
    pair.robot.clock.sleep(0.4)
    assert not any(pair.teleop.get_action().values())
    assert "the heading is not known" in caplog.text and "back in the local frame" in caplog.text


def test_the_emergency_stop_button_stops_the_base_and_its_release_moves_nothing(pair, pad):
    pad.push("lefty", -1.0)
    pair.run(3.0)
    pad.press("b")
    pair.run(1.0)
    assert pair.robot._base.client.mode() is Mode.STOPPED
    EmergencyStop().release()
    there = pair.truth
    pair.run(1.0)  # the stick is still pushed
    assert pair.truth == pytest.approx(there, abs=0.01)
    pad.push("lefty", 0.0)
    pair.run(0.1)
    pad.push("lefty", -1.0)
    pair.run(1.0)
    assert pair.truth[0] > there[0] + 0.05


def test_a_stick_moves_the_rail_no_faster_than_its_own_limit(tmp_path, pad):
    rail = Rail(tmp_path, height_m=0.2)
    config = rail.base(velocity_limit=0.1).config
    session = DeviceSession("yam_base", [config], "lockstep")
    teleop = YamGamepad(YamGamepadConfig(calibration_dir=tmp_path, rail=True))
    with contextlib.closing(rail.rig):
        teleop.connect()
        session.energise()
        try:
            pad.push("righty", -1.0)
            assert teleop.get_action()["height.vel"] == pytest.approx(0.1)
            for _ in range(30):
                session.base("base").write_rail_velocity(teleop.get_action()["height.vel"])
                session.clock.sleep(1 / 30)
            assert rail.height_m > 0.25
        finally:
            session.stop()
            teleop.disconnect()
