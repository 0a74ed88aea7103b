"""True samples of every step of the physics, and arms that weigh something else than their profile says."""

import itertools

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.simulation import rig_commands
from tests.support.rig_desk import Desk

CHANNEL = "follower_left"
SHOULDER, WRIST = 2, 6
LIFTED = np.array([0.0, 1.2, 1.0, 0.2, 0.0, 0.0])


@pytest.fixture
def desk():
    desk = Desk(friction=0)
    yield desk
    desk.close()


@pytest.fixture
def rig():
    rig = LockstepRig(arms=[CHANNEL], friction=0)
    yield rig
    rig.close()


def op(desk, name, **details):
    return rig_commands.ask(desk.device, {"op": name, "channel": CHANNEL, **details})


def test_every_step_is_kept_and_only_the_last_ones(rig):
    rig.truth_start(CHANNEL, 0.5)
    rig.sleep(0.8)
    truth = rig.truth(CHANNEL)
    assert truth["stamp_s"].shape == (500,) and truth["q"].shape == truth["dq"].shape == (500, 7)
    assert truth["torque_nm"].shape == truth["asked_nm"].shape == (500, 7)
    assert np.diff(truth["stamp_s"]) == pytest.approx(0.001)
    assert truth["stamp_s"][-1] == pytest.approx(rig.now(), abs=0.0011)
    assert truth["q"][-1, :6] == pytest.approx(rig.state()["arms"][CHANNEL]["q"])
    assert len(rig.truth(CHANNEL, after_s=rig.now() - 0.1)["stamp_s"]) == pytest.approx(100, abs=2)
    rig.truth_stop(CHANNEL)
    with pytest.raises(ConfigError, match="truth_start"):
        rig.truth(CHANNEL)


def test_each_start_begins_anew(rig):
    rig.truth_start(CHANNEL)
    rig.sleep(0.1)
    rig.truth_start(CHANNEL, 0.5)
    assert len(rig.truth(CHANNEL)["stamp_s"]) == 0
    rig.sleep(0.1)
    assert len(rig.truth(CHANNEL)["stamp_s"]) == 100
    for _ in range(2):
        rig.truth_stop(CHANNEL)


def test_looking_changes_nothing(desk):
    def swing(looked):
        desk = Desk(friction=0)
        if looked:
            op(desk, "truth", start=True)
        desk.special(WRIST, SpecialCommand.ENABLE)
        found = []
        for _ in range(50):
            found.append(desk.mit(WRIST, tau=1.0))
            desk.run(0.008)
        desk.close()
        return found

    assert swing(True) == swing(False)


def test_asked_torque_is_reported_beside_applied_torque(desk):
    op(desk, "truth", start=True)
    op(desk, "watch", start=True)
    desk.special(WRIST, SpecialCommand.ENABLE)
    kp, kd = 163 * 500 / 4095, 1638 * 5 / 4095  # what a frame can hold
    desk.mit(WRIST, q=2.0, dq=1.0, kp=kp, kd=kd, tau=1.5)
    desk.run(0.02)
    samples = op(desk, "truth")["samples"]
    for (_, q, dq, _, _), (_, _, _, torque, asked) in itertools.pairwise(samples):
        expected = kp * (2.0 - q[5]) + kd * (1.0 - dq[5]) + 1.5
        assert asked[5] == pytest.approx(expected, abs=0.05)
        assert torque[5] == pytest.approx(np.clip(expected, -10.0, 10.0), abs=0.05)
    assert max(sample[4][5] for sample in samples) > 30.0
    seen = op(desk, "watch")
    assert seen["max_torque_nm"][5] == pytest.approx(10.0)
    assert seen["max_asked_nm"][5] > 30.0
    assert seen["max_asked_at_s"][5] == pytest.approx(desk.now_s - 0.016, abs=0.005)


def test_the_grippers_torque_is_reported_too(desk):
    """Its drive is a tendon."""
    op(desk, "truth", start=True)
    desk.special(7, SpecialCommand.ENABLE)
    desk.mit(7, tau=3.0)
    desk.run(0.004)
    assert op(desk, "truth")["samples"][-1][4][6] == pytest.approx(3.0, abs=0.01)
    for bad in (0.0, 1e9, "long"):
        with pytest.raises(ConfigError):
            op(desk, "truth", start=True, seconds=bad)


def standing_torque(desk, q):
    """Torque that holds the arm's joints at q (6,), from the world's own model."""
    world = desk.device.world
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.data.qpos
    data.qpos[world.joint_addresses(CHANNEL)] = q
    mujoco.mj_forward(world.model, data)
    return data.qfrc_bias[world.joint_dofs(CHANNEL)]


def test_a_payload_pulls_as_a_mass_at_the_tool_does(desk):
    model = desk.device.world.model
    plain = standing_torque(desk, LIFTED)
    assert plain == pytest.approx(GravityModel("yam", "linear_4310").torque(LIFTED), abs=0.05)
    op(desk, "fault", motor=None, kind="payload_kg", value=0.8)
    loaded = standing_torque(desk, LIFTED)
    data = mujoco.MjData(model)
    data.qpos[:] = desk.device.world.data.qpos
    data.qpos[desk.device.world.joint_addresses(CHANNEL)] = LIFTED
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(f"{CHANNEL}/tcp_site").id)
    weight = jacobian.T @ [0.0, 0.0, 0.8 * 9.81]
    assert loaded - plain == pytest.approx(weight[desk.device.world.joint_dofs(CHANNEL)], abs=1e-3)
    assert np.abs(loaded - plain).max() > 1.0


def test_a_payload_has_the_inertia_of_a_point(desk):
    world = desk.device.world
    dofs = world.joint_dofs(CHANNEL)

    def inertia():
        mujoco.mj_forward(world.model, world.data)
        columns = np.zeros((len(dofs), world.model.nv))
        for column, unit in zip(columns, np.eye(world.model.nv)[dofs], strict=True):
            mujoco.mj_mulM(world.model, world.data, column, unit)
        return columns[:, dofs]

    before = inertia()
    op(desk, "fault", motor=None, kind="payload_kg", value=0.8)
    after = inertia()
    jacobian = np.zeros((3, world.model.nv))
    mujoco.mj_jacSite(world.model, world.data, jacobian, None, world.model.site(f"{CHANNEL}/tcp_site").id)
    assert after - before == pytest.approx(0.8 * jacobian[:, dofs].T @ jacobian[:, dofs], abs=1e-6)
    places = world.data.geom_xpos.copy(), world.data.site_xpos.copy()
    op(desk, "clear_faults")
    assert inertia() == pytest.approx(before, abs=1e-12)
    assert (world.data.geom_xpos, world.data.site_xpos) == (pytest.approx(places[0]), pytest.approx(places[1]))


def test_a_link_can_weigh_more_and_other_arms_stay_as_they_are():
    desk = Desk()
    before = desk.device.world.model.body_mass.copy()
    op(desk, "fault", motor=None, kind="link_mass", value={"link": "link3", "factor": 1.5})
    after = desk.device.world.model.body_mass
    index = desk.device.world.model.body(f"{CHANNEL}/link3").id
    assert after[index] == pytest.approx(1.5 * before[index])
    assert (np.delete(after, index) == np.delete(before, index)).all()
    with pytest.raises(ConfigError, match="no body 'elbow'; it has base, link1"):
        op(desk, "fault", motor=None, kind="link_mass", value={"link": "elbow", "factor": 1.5})
    op(desk, "clear_faults")
    assert (desk.device.world.model.body_mass == before).all()
    desk.close()
