"""A gripper's stops, searched and stored by a session."""

import contextlib

import pytest

from lerobot_robot_yam.arm.lifecycle import Mode
from lerobot_robot_yam.arm.session import ArmSession
from lerobot_robot_yam.arm.yam_arm import YamArm
from lerobot_robot_yam.errors import GripperError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep import LockstepRig

from .rigged import sim_config


def test_calibration_finds_and_keeps_the_stops(tmp_path):
    path = tmp_path / "left_gripper.json"
    with running_rig() as rig:
        config = sim_config(rig, "follower_left", gripper_stops_rad=None, calibration_path=str(path))
        with YamArm(config):
            assert path.exists()
        first = path.read_text()
        with YamArm(config) as arm:  # the second time they are verified only
            assert arm.observe().gripper == pytest.approx(1.0, abs=0.15)
    assert path.read_text() == first


def test_a_calibration_that_stores_nothing_has_failed_and_the_arm_is_held(tmp_path):
    blocked = tmp_path / "left"
    with contextlib.closing(LockstepRig(arms=["follower_left"])) as rig:
        config = sim_config(
            rig, "follower_left", interface="yam_lockstep", gripper_stops_rad=None, calibration_path=f"{blocked}/g.json"
        )
        session = ArmSession([config], isolation="lockstep")
        session.start(search_grippers=False)
        port = session["follower_left"]
        blocked.touch()  # a file where a directory has to be
        with pytest.raises(GripperError, match="follower_left: .*left/g.json cannot be read"):
            port.calibrate_gripper()
        blocked.unlink()
        port.calibrate_gripper()
        blocked.rename(tmp_path / "lost")
        blocked.symlink_to("/proc")  # where nobody can store anything
        with pytest.raises(GripperError, match="follower_left: nothing was stored in .*left/g.json; the log"):
            port.calibrate_gripper()
        assert port.observe().mode is Mode.HOLD
        session.discard()
