"""A base, alone or with two arms, that another computer drives: LeRobot sees what it sees of a local one."""

import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_mobile import YamBaseRemoteConfig, YamMobileRemoteConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.yam_mobile import YamBaseRemote, YamMobileRemote
from lerobot_teleoperator_yam.config_yam_gamepad import YamGamepadConfig
from lerobot_teleoperator_yam.yam_gamepad import YamGamepad
from tests.support.hosted import FOLLOWERS, mobile_rig_file, running_host
from tests.support.virtual_pad import VirtualPad
from tests.support.waiting import wait

pytestmark = [pytest.mark.long, pytest.mark.alone]

SPEED = {"x.vel": 0.2, "y.vel": 0.0, "theta.vel": 10.0}


def mapped(host):
    """What the host's processes have loaded."""
    pids = [host.process.pid]
    for pid in pids:
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            pids += map(int, children.read_text().split())
    return [Path(f"/proc/{pid}/maps").read_text() for pid in pids]


def drive(robot, action, until):
    """Send an action, or what it returns, until an observation satisfies `until`.

    On a busy machine the base brakes now and then.
    """
    deadline = time.monotonic() + 20.0
    while not until(seen := robot.get_observation()):
        assert time.monotonic() < deadline, seen
        robot.send_action(action() if callable(action) else action)
        time.sleep(0.03)


def enabled(rig):
    return any(motor["enabled"] for motor in rig.state()["base"]["motors"].values())


def test_a_base_drives_over_the_link_and_its_host_loads_little(tmp_path):
    with running_rig(scene="mobile") as rig, running_host(mobile_rig_file(tmp_path, rig), tmp_path) as host:
        robot = YamBaseRemote(YamBaseRemoteConfig(host=str(host.address), observe_odometry=True))
        assert robot.name == "yam_base" and list(robot.action_features) == list(SPEED) and robot.is_calibrated
        robot.connect()
        try:
            drive(robot, SPEED, lambda seen: seen["x.pos"] > 0.2 and seen["x.vel"] > 0.1 and seen["theta.vel"] > 5.0)
            assert len(found := mapped(host)) >= 3
            assert not any(name in maps for maps in found for name in ("torch", "libmujoco"))
            time.sleep(0.25 + 0.2 / 0.25 + 0.3)  # without targets: time-out and planned braking
            seen, pose = robot.get_observation(), rig.state()["base"]["pose"]
            assert abs(seen["x.vel"]) < 0.01
            assert seen["x.pos"] == pytest.approx(pose[0], abs=0.03) and pose[0] > 0.2
        finally:
            robot.disconnect()
        assert not enabled(rig)


def test_a_base_with_arms_drives_and_moves_over_the_link(tmp_path):
    rigs = running_rig(scene="mobile_tables", arms=list(FOLLOWERS))
    with rigs as rig, running_host(mobile_rig_file(tmp_path, rig, FOLLOWERS), tmp_path) as host:
        with pytest.raises(RefusedConfigError, match="is a yam_mobile; its type here is yam_mobile_remote"):
            YamBaseRemoteConfig(host=str(host.address))
        robot = YamMobileRemote(YamMobileRemoteConfig(host=str(host.address)))
        assert robot.name == "yam_mobile" and list(robot.action_features)[-3:] == list(SPEED)
        before = np.array(rig.state()["base"]["pose"])
        robot.connect()
        try:
            with pytest.raises(ConfigError, match="on its own computer"):
                robot.calibrate()
            seen = robot.get_observation()
            arms = {name: seen[name] for name in robot.action_features if name.endswith(".pos")}
            arms["left_joint_2.pos"] += 0.3
            there = arms["left_joint_2.pos"]
            drive(robot, arms | SPEED, lambda seen: abs(seen["left_joint_2.pos"] - there) < 0.1)
            begin = time.monotonic()
            drive(robot, arms | SPEED, lambda seen: seen["x.vel"] > 0.1 and time.monotonic() > begin + 2.0)
            assert np.linalg.norm((np.array(rig.state()["base"]["pose"]) - before)[:2]) > 0.1
        finally:
            robot.disconnect()
        assert not enabled(rig)


def test_the_pads_emergency_stop_reaches_the_base_over_the_link(tmp_path, monkeypatch):
    """The workstation is a computer of its own, with a runtime directory of its own."""
    there, pad = EmergencyStop(), VirtualPad()
    rigs = running_rig(scene="mobile")
    with rigs as rig, running_host(mobile_rig_file(tmp_path, rig), tmp_path) as host, monkeypatch.context() as patch:
        (tmp_path / "workstation").mkdir(mode=0o700)
        patch.setenv("YAM_RUNTIME_DIR", str(tmp_path / "workstation"))
        robot = YamBaseRemote(YamBaseRemoteConfig(host=str(host.address), observe_odometry=True))
        teleop, stop = YamGamepad(YamGamepadConfig(calibration_dir=tmp_path)), EmergencyStop()
        try:
            teleop.connect()
            robot.connect()
            pad.push("lefty", -1.0)
            drive(robot, teleop.get_action, lambda seen: seen["x.vel"] > 0.2)
            pad.press("b")
            drive(robot, teleop.get_action, lambda _: robot._base.client.mode() is Mode.STOPPED)
            assert there.reason().startswith("workstation ") and there.directory != stop.directory
            drive(robot, teleop.get_action, lambda seen: abs(seen["x.vel"]) < 0.01)
            stop.release()
            wait(lambda: not there.latched)
            drive(robot, teleop.get_action, lambda _: robot._base.client.mode() is not Mode.STOPPED)
            before = robot.get_observation()["x.pos"]
            until = time.monotonic() + 1.0
            drive(robot, teleop.get_action, lambda _: time.monotonic() > until)  # the stick is still pushed
            assert robot.get_observation()["x.pos"] == pytest.approx(before, abs=0.01)
        finally:
            stop.release()
            robot.disconnect()
            teleop.disconnect()
            pad.unplug()
        assert not enabled(rig)
