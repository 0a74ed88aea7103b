"""How well the arm is where it was asked to be, by the rig's own truth."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.profile_files import GRIPPERS, load_gripper
from tests.control.test_landing import random_poses
from tests.support.rigged import LIVE, arm_that_stays_up, rig_of

CHANNEL = "follower_left"


def connect(rig, gripper="linear_4310"):
    calibration = load_gripper(gripper).calibration
    stops_rad = None if calibration is None else calibration.nominal_stops_rad.tolist()
    return arm_that_stays_up(rig, CHANNEL, gripper=gripper, gripper_stops_rad=stops_rad)


def hold_errors(kind, gripper, poses, friction):
    """(k, 6) |true q − target| after settling, rad."""
    errors = []
    with rig_of(kind, arms=[CHANNEL], gripper=gripper, friction=friction) as rig, connect(rig, gripper) as arm:
        for q in poses:
            arm.move_to(q, speed_rad_s=1.3)
            arm.clock.sleep(1.5)
            true = np.array(rig.state()["arms"][CHANNEL]["q"][:6])
            errors.append(np.abs(true - q))
    return np.array(errors)


@pytest.mark.long
@pytest.mark.parametrize("gripper", ["linear_4310"])
def test_without_friction_the_arm_holds_within_3_mrad(gripper):
    assert hold_errors("lockstep", gripper, random_poses(2, seed=3, gripper=gripper), friction=0.0).max() <= 0.003


@pytest.mark.long
@pytest.mark.parametrize("gripper", GRIPPERS)
def test_without_friction_every_gripper_holds_within_3_mrad_at_ten_poses(gripper, record_property):
    poses = random_poses(10, seed=5, gripper="linear_4310")
    errors = hold_errors("live", gripper, poses, friction=0.0)
    record_property("hold_error_mrad", (errors.max(axis=0) * 1e3).round(2).tolist())
    assert errors.max() <= 0.003


@pytest.mark.parametrize("kind", ["lockstep", LIVE])
def test_a_half_hertz_sweep_is_tracked_within_15_mrad_rms(kind):
    centre = np.array([0.0, 1.2, 1.2, 0.0, 0.0, 0.0])
    errors = []
    with rig_of(kind, arms=[CHANNEL]) as rig, connect(rig) as arm:
        arm.move_to(centre)
        begin = arm.clock.now()
        while (t := arm.clock.now() - begin) < 5.0:
            arm.command(centre + 0.3 * np.sin(np.pi * t))
            state = arm.observe()
            if t > 1.0:
                errors.append(state.q - state.setpoint_q)
            arm.clock.sleep(1 / 60)
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() <= 0.015
