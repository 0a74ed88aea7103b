"""Two moments per link stand for every change of masses and centres, and four numbers for a payload."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS
from lerobot_robot_yam.commands.lib.tune.gravity_terms import GravityTerms
from lerobot_robot_yam.rig.scene.deviation import Deviation
from lerobot_robot_yam.rig.world.world_model import carried
from tests.support.deviating import deviation

NEAR_NM = 1e-4
PAYLOAD_KG, AT_M = 0.4, (0.02, -0.03, 0.05)


def poses(arm, count=100):
    low, high = arm.joint_limits_rad.T
    return np.random.default_rng(5).uniform(low, high, (count, arm.joint_count))


def changed(arm, gripper, seed):
    row = deviation(seed, arm=arm, gripper=gripper)
    made = Deviation(
        mass=row["mass"],
        centre={link: np.array(factors) for link, factors in row["centre"].items()},
        payload_mass_kg=PAYLOAD_KG,
        payload_com_m=np.array(AT_M),
    )
    return made.apply(arm, gripper), carried(made)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (1.57, 0.3)], ids=["upright", "on a wall"])
@pytest.mark.parametrize("name", [name for name in ARMS if name != "none"])
def test_moments_stand_for_every_change_of_masses_and_centres(name, tilt):
    arm, gripper = resolve_profiles(name, "linear_4310")
    terms = GravityTerms(arm, gripper, tilt_rad=tilt)
    assert len(terms.terms) == 2 * (arm.joint_count - (tilt == (0.0, 0.0)))  # an upright base carries no weight
    true_profiles, load = changed(arm, gripper, 1)
    true = GravityModel(*true_profiles, load=load, tilt_rad=tilt)
    where = poses(arm)
    misses = np.array([true.torque(q) - terms.torque(q) for q in where]).ravel()
    rows = np.concatenate([terms.moments(q) for q in where])
    x, _, rank, _ = np.linalg.lstsq(rows, misses, rcond=None)
    assert np.abs(misses).max() > 0.5 and rank == len(terms.terms)
    assert np.abs(rows @ x - misses).max() < NEAR_NM


def test_four_numbers_stand_for_a_payload():
    arm, gripper = resolve_profiles("yam", "linear_4310")
    terms = GravityTerms(arm, gripper)
    held = GravityModel(arm, gripper, payload_mass_kg=PAYLOAD_KG, payload_com_m=AT_M)
    numbers = PAYLOAD_KG * np.array([1.0, *AT_M])
    for q in poses(arm):
        np.testing.assert_allclose(terms.payload(q) @ numbers, held.torque(q) - terms.torque(q), atol=NEAR_NM)


def test_a_bare_wrist_has_no_moment():
    terms = GravityTerms(*resolve_profiles("yam", "no_gripper"))
    assert {term.joint for term in terms.terms} == {1, 2, 3, 4}
