"""The file of a tuning, and what an arm becomes by it."""

import dataclasses

import numpy as np
import pytest
import yaml

from lerobot_robot_yam.arm.config import ArmConfig, check_together
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tuning import Payload, Tuning, load_tuning, save_tuning
from lerobot_robot_yam.commands.lib.tune.gravity_terms import GravityTerms
from lerobot_robot_yam.errors import ConfigError

RUBS = [0.1, 0.2, 0.3, 0.05, 0.05, 0.05]
TERMS = GravityTerms(*resolve_profiles("yam", "linear_4310"))
X = np.linspace(-0.02, 0.03, len(TERMS.terms))
Q = np.array([0.3, 1.2, 0.9, -0.4, 0.5, 0.2])


@pytest.fixture
def tuning():
    moments = np.zeros((6, 3))
    for term, value in zip(TERMS.terms, X, strict=True):
        moments[term.joint] += value * term.axis
    zeros = np.zeros(6)
    return Tuning(
        arm="yam",
        gripper="linear_4310",
        moment_kg_m=moments,
        moment_kg_m_95=np.zeros((6, 3)),
        gravity_factor=np.full(6, 1.1),
        gravity_factor_95=zeros,
        coulomb_nm=np.array(RUBS),
        coulomb_nm_95=zeros,
        viscous_nm_s=zeros,
        viscous_nm_s_95=zeros,
    )


@pytest.fixture
def path(tuning, tmp_path):
    path = tmp_path / "new" / "left.yaml"
    save_tuning(path, tuning)
    return path


def resolved(path, **fields):
    return ResolvedArm(ArmConfig(name="left", channel="can0", tuning=str(path), **fields))


def weight(hardware):
    model = GravityModel(hardware.arm, hardware.gripper, load=hardware.load)
    return model.torque(Q) * hardware.arm.gravity_factor


def test_an_arm_weighs_and_rubs_as_its_tuning_says(path):
    hardware = resolved(path)
    np.testing.assert_allclose(weight(hardware), TERMS.torque(Q) + TERMS.moments(Q) @ X, atol=1e-3)
    assert hardware.arm.coulomb_friction_nm.tolist() == RUBS
    assert [entry.name for entry in path.parent.iterdir()] == ["left.yaml"]  # nothing half done is left


def test_a_gravity_factor_of_the_config_still_counts(path):
    np.testing.assert_allclose(weight(resolved(path, gravity_factor=[0.5] * 6)), 0.5 * weight(resolved(path)))


def test_a_payload_of_the_tuning_is_carried(path, tuning):
    save_tuning(path, dataclasses.replace(tuning, payload=Payload(mass_kg=0.5, com_m=np.array([0.0, 0.0, 0.1]))))
    assert resolved(path).load.payload_mass_kg == 0.5 and resolved(path).load.payload_com_m == (0.0, 0.0, 0.1)
    with pytest.raises(ConfigError, match=r"left: tuning has a payload of 0.5 kg, and payload_mass_kg is 1; leave"):
        resolved(path, payload_mass_kg=1.0)


def test_what_the_end_effector_weighs_is_said_once(path):
    with pytest.raises(ConfigError, match="left: tuning and ee_inertia both say what the end effector weighs"):
        resolved(path, ee_inertia=[0, 0, 0, 1, 0, 0, 0, 1e-3, 1e-3, 1e-3])


def test_a_tuning_of_another_arm_is_refused(path):
    with pytest.raises(ConfigError, match="left: tuning is of arm yam with linear_4310, not of yam with crank_4310"):
        resolved(path, gripper="crank_4310")


def test_two_arms_do_not_share_a_tuning(path):
    arms = [ArmConfig(name=name, channel=name, tuning=str(path)) for name in ("left", "right")]
    with pytest.raises(ConfigError, match="left, right: each arm needs a tuning of its own"):
        check_together(arms)


@pytest.mark.parametrize(
    "change, says",
    [
        ({"coulomb_nm": [0.1] * 5}, "its lists need one entry per joint"),
        ({"viscous_nm_s": [-0.1] * 6}, "viscous_nm_s takes numbers within 0 … 5"),
        ({"moment_kg_m": [[0.0, 0.0, 9.0]] * 6}, "puts the centre of mass of link1 88.92 m from where its profile"),
        ({"moment_kg_m": [[0.0, 0.0]] * 6}, "moment_kg_m: expected numbers"),
        ({"payload": {"mass_kg": 4.0}}, "payload.mass_kg takes a mass within 0 … 3 kg"),
        ({"mass_kg": 1.0}, "unknown keys"),
        ({"arm": None}, "arm: expected str"),
    ],
)
def test_what_no_arm_can_be_is_refused(path, change, says):
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))
    with pytest.raises(ConfigError, match=says):
        resolved(path)


def test_a_file_that_cannot_be_read_or_written_is_named(path, tuning, tmp_path):
    with pytest.raises(ConfigError, match="left: cannot read .*absent.yaml"):
        resolved(tmp_path / "absent.yaml")
    with pytest.raises(ConfigError, match="cannot be written"):
        save_tuning(path / "below.yaml", tuning)
    assert load_tuning(path).gravity_factor.tolist() == [1.1] * 6
