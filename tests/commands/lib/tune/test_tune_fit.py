"""What a fit makes of samples of an arm that differs from its profile."""

import re

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.tune.gravity_terms import GravityTerms
from lerobot_robot_yam.commands.lib.tune.tune_fit import fit
from lerobot_robot_yam.commands.lib.tune.tune_motion import MARGIN_M, Route, expected, torque_steps
from lerobot_robot_yam.errors import ConfigError
from tests.support.deviating import deviation, scene, true_gravity

COULOMB_NM = np.array([0.3, 0.25, 0.2, 0.1, 0.08, 0.06])
VISCOUS_NM_S = np.array([0.3, 0.2, 0.1, 0.05, 0.04, 0.03])


@pytest.fixture(scope="module")
def hardware():
    return ResolvedArm(ArmConfig(name="left", channel="can0", rate_hz=0.0))


@pytest.fixture(scope="module")
def poses(hardware):
    terms = GravityTerms(hardware.arm, hardware.gripper)
    workspace = WorkspaceConfig(floor_z_m=MARGIN_M, collision_margin_m=MARGIN_M)
    return Route(hardware, terms, workspace).plan(hardware.rest_q, 6)


@pytest.fixture
def true(tmp_path):
    return true_gravity(scene(tmp_path, deviation(11)))


def samples(hardware, model, poses):
    """Of a sweep of an arm that weighs as the model says, and rubs; motors round their torques down."""
    plain = expected(hardware, model, poses)
    tau = plain.tau + COULOMB_NM * np.sign(plain.dq) + VISCOUS_NM_S * plain.dq
    return plain._replace(tau=tau - 0.5 * torque_steps(hardware))


def weights(tuning, hardware, where):
    model = GravityModel(*tuning.tuned(hardware.arm, hardware.gripper), load=tuning.load)
    return np.array([model.torque(q) for q in where])


def anywhere(hardware):
    low, high = hardware.arm.joint_limits_rad.T
    return np.random.default_rng(3).uniform(low, high, (100, hardware.joints))


def test_weight_and_friction_are_found(hardware, poses, true):
    found = fit(hardware, samples(hardware, true, poses))
    where = anywhere(hardware)
    misses = weights(found.tuning, hardware, where) - [true.torque(q) for q in where]
    assert (np.abs(misses) < 2.0 * torque_steps(hardware)).all()
    tuning = found.tuning
    for value, half, truth in (
        (tuning.coulomb_nm, tuning.coulomb_nm_95, COULOMB_NM),
        (tuning.viscous_nm_s, tuning.viscous_nm_s_95, VISCOUS_NM_S),
    ):
        assert (half > 0.0).all() and (half < 0.1).all()
        assert (np.abs(value - truth) < 3.0 * half).all()  # intervals of 95 % hold


def test_a_payload_is_told_from_the_arm(hardware, poses, tmp_path):
    row = deviation(12, payload_kg=0.0)
    bare = fit(hardware, samples(hardware, true_gravity(scene(tmp_path, row)), poses)).tuning
    row |= {"payload_mass_kg": 0.4}
    loaded = true_gravity(scene(tmp_path, row))
    found = fit(hardware, samples(hardware, loaded, poses), bare)
    load = found.tuning.payload
    assert load.mass_kg == pytest.approx(0.4, abs=0.01) and 0.0 < load.mass_kg_95 < 0.02
    np.testing.assert_allclose(load.com_m, row["payload_com_m"], atol=0.005)
    np.testing.assert_array_equal(found.tuning.moment_kg_m, bare.moment_kg_m)
    where = anywhere(hardware)
    misses = weights(found.tuning, hardware, where) - [loaded.torque(q) for q in where]
    assert (np.abs(misses) < 3.0 * torque_steps(hardware)).all()


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_without_data_is_named(hardware, poses, true, joint):
    """It hangs still: neither its friction nor its own moment shows in any motor."""
    still = poses.copy()
    still[:, joint] = poses[0, joint]
    with pytest.raises(ConfigError) as refused:
        fit(hardware, samples(hardware, true, still))
    (own,) = re.findall(rf"joint_{joint + 1} \((.*?)\)", str(refused.value))
    assert "Coulomb friction, viscous friction" in own
    assert joint == 0 or "moment" in own
