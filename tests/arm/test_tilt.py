"""Bases that do not stand upright: on a wall, under a ceiling, on a slope."""

import contextlib

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.model import base_quat, build_model
from lerobot_robot_yam.control.landing.landing_move import LANDING_SPEED_RAD_S
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.modes import Mode
from tests.control import test_wrong_model
from tests.support.landed import MOST_M
from tests.support.rigged import session_on, sim_config, track

TILTS = {"wall": [1.5708, 0.0], "nose down": [0.0, 1.5708], "ceiling": [3.1416, 0.0], "slope": [0.5, 0.3]}
POSE = np.array([0.3, 1.0, 1.0, 0.2, 0.2, 0.1])


@contextlib.contextmanager
def arm_at(tmp_path, tilt, role="follower", gripper="linear_4310", **fields):
    """A rig with one arm whose base is tilted so, 1.2 m above the table, and a session of it."""
    channel = f"{role}_left"
    scene = tmp_path / "tilted.yaml"
    arm = (
        f"{{channel: {channel}, role: {role}, arm: yam, gripper: {gripper}, position_m: [0, 0, 1.2], tilt_rad: {tilt}}}"
    )
    scene.write_text(f"name: tilted\narms: [{arm}]\n")
    with contextlib.closing(LockstepRig(scene)) as rig:
        session = session_on(rig, sim_config(rig, channel, **fields))
        try:
            yield rig, session
        finally:
            session.discard()


def test_an_upright_base_changes_no_bit():
    rng = np.random.default_rng(3)
    model, told = GravityModel("yam", "linear_4310"), GravityModel("yam", "linear_4310", tilt_rad=(0.0, 0.0))
    assert model.model.opt.gravity.tolist() == told.model.opt.gravity.tolist() == [0.0, 0.0, -9.81]
    assert base_quat(0.7).tolist() == [np.cos(0.35), 0.0, 0.0, np.sin(0.35)]
    for q in rng.uniform(0, 1, (20, 6)):
        assert model.torque(q).tolist() == told.torque(q).tolist()


@pytest.mark.parametrize("tilt", TILTS.values(), ids=TILTS)
def test_the_torque_is_the_gradient_of_the_height_above_the_room_s_floor(tilt):
    """d/dq of the potential energy, with the base turned in the room instead of gravity in the base."""
    model, load_kg = build_model("yam", "linear_4310", visuals=False), 0.7
    ours = GravityModel("yam", "linear_4310", tilt_rad=tilt)
    loaded = GravityModel("yam", "linear_4310", tilt_rad=tilt, payload_mass_kg=load_kg)
    data, rotation = mujoco.MjData(model), np.empty(9)
    mujoco.mju_quat2Mat(rotation, base_quat(0.4, tilt))
    up = rotation.reshape(3, 3)[2]  # of the room, in the base's axes

    def energy(q):
        data.qpos[:6] = q
        mujoco.mj_forward(model, data)
        return 9.81 * float(model.body_mass @ (data.xipos @ up)), 9.81 * load_kg * float(
            data.site("tcp_site").xpos @ up
        )

    for q in np.random.default_rng(5).uniform(0.1, 1.2, (4, 6)):
        steps = 1e-5 * np.eye(6)
        gradient = np.array([np.subtract(energy(q + step), energy(q - step)) / 2e-5 for step in steps])
        np.testing.assert_allclose(ours.torque(q), gradient[:, 0], atol=1e-5)
        np.testing.assert_allclose(load_kg * ours.torque_per_kg(q), gradient[:, 1], atol=1e-5)
        np.testing.assert_allclose(loaded.torque(q), gradient.sum(axis=1), atol=1e-5)


@pytest.mark.parametrize("name", ["wall", *(pytest.param(name, marks=pytest.mark.long) for name in [*TILTS][1:])])
def test_a_tilted_arm_is_carried_and_lands_where_it_hangs(tmp_path, name):
    tilt = TILTS[name]
    with arm_at(tmp_path, tilt, base_tilt_rad=tilt, hold_integral=False) as (rig, session):
        channel = "follower_left"
        session.start()
        track(session, {channel: POSE}, 2.0)
        session.clock.sleep(0.5)
        np.testing.assert_allclose(rig.state()["arms"][channel]["q"], POSE, atol=0.02)  # without sag
        session[channel].float()
        session.clock.sleep(1.0)
        np.testing.assert_allclose(rig.state()["arms"][channel]["q"], POSE, atol=0.05)
        moved, speeds, _ = test_wrong_model.land(rig, session)
    assert moved <= MOST_M
    assert np.sort(speeds, axis=0)[-test_wrong_model.BRIEF].max() < 1.2 * LANDING_SPEED_RAD_S


@pytest.mark.long
def test_a_tilted_arm_lands_at_its_configured_rest_pose(tmp_path):
    rest = [0.0, 1.57, 2.8, 0.2, 0.0, 0.0]  # about where it hangs from the ceiling
    with arm_at(tmp_path, TILTS["ceiling"], base_tilt_rad=TILTS["ceiling"], rest_q_rad=rest) as (rig, session):
        session.start()
        track(session, {"follower_left": POSE}, 2.0)
        moved, _, took_s = test_wrong_model.land(rig, session)
        np.testing.assert_allclose(rig.state()["arms"]["follower_left"]["q"], rest, atol=0.3)
    assert moved <= MOST_M
    assert took_s < 10.0


@pytest.mark.long
def test_a_tilted_leader_floats_if_it_is_told_and_is_refused_if_not(tmp_path):
    leader = {"role": "leader", "gripper": "yam_teaching_handle"}
    with arm_at(tmp_path, TILTS["wall"], **leader, base_tilt_rad=TILTS["wall"]) as (rig, session):
        session.start()
        before = rig.state()["arms"]["leader_left"]["q"]
        session.clock.sleep(2.0)
        assert session["leader_left"].observe().mode is Mode.FLOAT
        np.testing.assert_allclose(rig.state()["arms"]["leader_left"]["q"], before, atol=0.05)
    with arm_at(tmp_path, TILTS["wall"], **leader) as (_, session), pytest.raises(MotorError, match="base_tilt_rad"):
        session.start()
