"""Gravity torques, kinematics and inertia against published reference values and physical laws."""

import json

import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.profile import Load
from lerobot_robot_yam.arm.profile_files import ARMS, load_gripper
from lerobot_robot_yam.errors import ConfigError
from tests.support.paths import GOLDEN

Q = np.array([0.3, 1.0, 1.2, -0.4, 0.5, -0.6])


REVISED = ("yam_ultra_2",)  # their references come from a later model, whose wrist mount is rounded to five digits
ORIGINAL = tuple(arm for arm in ARMS if arm not in REVISED)


def document(name):
    return json.loads((GOLDEN / f"{name}.json").read_text())


def golden(name):
    return document(name)["cases"]


def gravity(arm):
    """Torques by gripper, of those grippers of which the maker publishes a model."""
    return document(arm)["gravity"] if arm in REVISED else golden("gravity_torques")[arm]


def test_the_references_are_of_all_arms_and_grippers_of_the_maker():
    assert min(len(gravity(arm)) for arm in ARMS) >= 6


@pytest.mark.parametrize(("arm", "gripper"), [(arm, gripper) for arm in ARMS for gripper in gravity(arm)])
def test_gravity_torque_matches_reference(arm, gripper):
    model = GravityModel(arm, gripper)
    cases = gravity(arm)[gripper]
    tolerance_nm = 1e-4 if arm in REVISED else 1e-6  # as the references state it
    assert len(cases) == (12 if arm in REVISED else 20)
    for case in cases:
        np.testing.assert_allclose(model.torque(np.array(case["q"])), case["tau"], rtol=0, atol=tolerance_nm)


@pytest.mark.parametrize("arm", ARMS)
def test_kinematics_match_reference(arm):
    tolerance_m = 2e-5 if arm in REVISED else 1e-6
    for site in ("tcp_site", "grasp_site"):
        kinematics = YamKinematics(arm, "linear_4310", site)
        for case in document(arm)["fk"] if arm in REVISED else golden("fk")[arm]:
            np.testing.assert_allclose(kinematics.fk(np.array(case["q"])), case[site], rtol=0, atol=tolerance_m)


def mass_matrix(model, q):
    """(n, n) kg m²: column j is the torque that accelerates joint j by 1 rad/s²."""
    return np.array([model.torques(q, np.zeros(len(q)), unit)[2] for unit in np.eye(len(q))]).T


@pytest.mark.parametrize("arm", ORIGINAL)
def test_mass_matrix_matches_reference(arm):
    model = GravityModel(arm, "linear_4310")
    for case in golden("mass_matrix")[arm]:
        np.testing.assert_allclose(mass_matrix(model, np.array(case["q"])), case["M"], rtol=0, atol=1e-6)


@pytest.mark.parametrize("arm", ARMS)
def test_moving_and_accelerating_take_what_lagrange_says(arm):
    """c_i = Σ_jk (∂M_ij/∂q_k − ½ ∂M_jk/∂q_i) dq_j dq_k, and M ddq."""
    model, step = GravityModel(arm, "linear_4310"), 1e-5
    dq, ddq = np.array([1.0, -1.5, 1.2, 0.8, -2.0, 3.0]), np.array([30.0, -20.0, 10.0, 5.0, -30.0, 30.0])
    slopes = [(mass_matrix(model, Q + step * e) - mass_matrix(model, Q - step * e)) / (2 * step) for e in np.eye(6)]
    by_k = np.moveaxis(np.array(slopes), 0, 2)  # (i, j, k)
    moving = np.einsum("ijk,j,k->i", by_k, dq, dq) - 0.5 * np.einsum("jki,j,k->i", by_k, dq, dq)
    at_rest = model.torque(Q)
    holding, turning, accelerating = model.torques(Q, dq, ddq)
    np.testing.assert_array_equal(holding, at_rest)
    np.testing.assert_allclose(turning, moving, atol=1e-6)
    np.testing.assert_allclose(accelerating, mass_matrix(model, Q) @ ddq, atol=1e-9)
    assert np.abs(turning).max() > 0.1
    np.testing.assert_array_equal(model.torque(Q), at_rest)  # nothing of the motion is left
    assert np.isnan(model.torques(Q, dq * np.nan, ddq)[1]).any()
    np.testing.assert_array_equal(model.torque(Q), at_rest)


def test_torque_is_the_gradient_of_potential_energy_of_a_payload():
    """The payload's share of tau is d(m g z)/dq at its own place in the tool frame."""
    mass, com = 0.7, (0.02, -0.01, 0.15)
    bare, kinematics = GravityModel("yam", "linear_4310"), YamKinematics("yam", "linear_4310")
    loaded = GravityModel("yam", "linear_4310", payload_mass_kg=mass, payload_com_m=com)

    def energy(q):
        return mass * 9.81 * (kinematics.fk(q) @ [*com, 1.0])[2]

    step = 1e-5
    gradient = [(energy(Q + step * e) - energy(Q - step * e)) / (2 * step) for e in np.eye(6)]
    np.testing.assert_allclose(loaded.torque(Q) - bare.torque(Q), gradient, atol=1e-7)


def test_end_effector_overrides():
    own = load_gripper("linear_4310").bodies[0].inertial
    same = [*own.com_m, *own.quat_wxyz, *own.moments_kg_m2]
    plain = GravityModel("yam", "linear_4310").torque(Q)
    np.testing.assert_allclose(
        GravityModel("yam", "linear_4310", load=Load(ee_inertia=same)).torque(Q), plain, atol=1e-12
    )
    lighter = GravityModel("yam", "linear_4310", ee_mass_kg=load_gripper("linear_3507").bodies[0].inertial.mass_kg)
    np.testing.assert_allclose(lighter.torque(Q), GravityModel("yam", "linear_3507").torque(Q), atol=1e-12)
    moved = [0.0, 0.0, -0.1, 1, 0, 0, 0, 1e-4, 1e-4, 1e-4]
    assert np.abs(GravityModel("yam", "linear_4310", ee_inertia=moved).torque(Q) - plain).max() > 0.1


@pytest.mark.parametrize(
    "fields",
    [
        {"payload_mass_kg": -1.0},
        {"payload_mass_kg": float("nan")},
        {"payload_com_m": (0.0, 1.0)},
        {"ee_mass_kg": -0.1},
        {"ee_inertia": [0.0] * 9},
        {"ee_inertia": [0.0] * 10},
    ],
)
def test_impossible_loads_are_refused(fields):
    with pytest.raises(ConfigError):
        Load(**fields)


def test_arm_less_model_has_no_torque_and_an_unknown_site_is_named():
    model = GravityModel("none", "linear_4310")
    assert model.torque(np.zeros(0)).shape == (0,)
    with pytest.raises(ConfigError, match="tcp_site"):
        YamKinematics("yam", "yam_teaching_handle", "grasp_site")


def test_result_is_not_overwritten_by_the_next_call():
    model = GravityModel("yam", "linear_4310")
    first = model.torque(Q)
    copy = first.copy()
    model.torque(np.zeros(6))
    np.testing.assert_array_equal(first, copy)
