"""An arm of seven joints from a user's own profile, on a rig in lock-step: through the whole loop like any other."""

import contextlib
import dataclasses
import re
from pathlib import Path

import can
import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.clearance import Clearance
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.mounting import arm_ids, gripper_id, mounted, resolve_profiles
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.preflight.fingerprint import read_fingerprint
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.modes import Mode
from tests.control.test_landing import land_and_watch
from tests.support.landed import MOST_M
from tests.support.rigged import arm_on, session_on, sim_config
from tests.support.seven_joints import ARM, REACH, write_scene

FOLLOWER, LEADER = "follower_left", "leader_left"
NAMED, NOBODY = re.compile("folding: .*"), "folding: {base: null, shoulder: null, elbow: null, wrist: null}"
GAINS = {"arm": ARM, "gravity_factor": [1.0] * 7}


@pytest.fixture
def rig(tmp_path):
    with contextlib.closing(LockstepRig(write_scene(tmp_path))) as rig:
        yield rig


# the profile


def test_the_gripper_has_an_id_and_joints_of_its_own():
    hardware = ResolvedArm(ArmConfig(channel="any", arm=ARM))
    assert [(motor.name, motor.can_id) for motor in hardware.motors] == [
        *((f"joint_{n}", n) for n in range(1, 8)),
        ("gripper", 8),
    ]
    model = build_model(ARM, "linear_4310")
    assert [model.joint(i).name for i in range(model.njnt)] == [f"joint{n}" for n in range(1, 10)]


@pytest.mark.parametrize(("said", "found"), [(None, 8), (12, 12)])
def test_a_gripper_whose_id_a_joint_has_takes_the_next_one_unless_the_profile_says_another(said, found):
    assert gripper_id(load_arm(ARM, {"gripper_can_id": said})) == found
    assert gripper_id(load_arm("yam")) == 7 and gripper_id(load_arm("none")) == 7
    with pytest.raises(ConfigError, match="gripper_can_id 3 is the id of a joint"):
        load_arm(ARM, {"gripper_can_id": 3})


def test_an_end_effector_that_is_fixed_to_a_link_in_the_middle_is_refused():
    handle = load_gripper("no_gripper")
    wrong = dataclasses.replace(handle, bodies=(dataclasses.replace(handle.bodies[0], parent="link6"),))
    with pytest.raises(ConfigError, match=r"link6.*last one of arm 'arm7' \(link7\); write `parent: tip`"):
        mounted(wrong, load_arm(ARM))
    assert mounted(wrong, load_arm("yam")).bodies[0].parent == "link6"


@pytest.mark.parametrize("key", ["kp", "gravity_factor", "coulomb_friction_nm", "effort_limit_nm", "speed_limit_rad_s"])
def test_numbers_per_joint_are_counted_by_the_profile(key):
    assert ResolvedArm(ArmConfig(channel="any", arm=ARM, **{key: [1.0] * 7})).joints == 7
    with pytest.raises(ConfigError, match=f"{key} takes 7 numbers, one per joint"):
        ResolvedArm(ArmConfig(channel="any", arm=ARM, **{key: [1.0] * 6}))


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        ({"folding": {"wrist": "joint_9"}}, "folding.wrist: there is no motor 'joint_9'"),
        ({"folding": {"knee": "joint_4"}}, "knee"),
        ({"zero_pose": {"joint_0": "bent"}}, "zero_pose.joint_0"),
    ],
)
def test_what_names_a_joint_that_there_is_none_of_is_refused(overrides, complaint):
    with pytest.raises(ConfigError, match=complaint):
        load_arm(ARM, overrides)


# the model


def test_inverse_kinematics_solve_for_seven_joints():
    kinematics = YamKinematics(ARM, "linear_4310", "grasp_site")
    for q in np.random.default_rng(0).uniform(kinematics.lower, kinematics.upper, size=(20, 7)):
        found = kinematics.ik(kinematics.fk(q), budget_s=10.0)  # however busy the machine is
        assert found.converged and found.q.shape == (7,)
    near = kinematics.ik(kinematics.fk(REACH), np.add(REACH, 0.05), attempts=1)
    assert near.converged and np.abs(near.q - REACH).max() < 0.2  # what the pose leaves open stays near
    with pytest.raises(ActionError, match=r"shape \(7,\)"):
        kinematics.fk(np.zeros(6))


def test_parts_of_the_arm_keep_their_distance_with_the_fingers_open():
    clearance = Clearance(
        [GuardedArm("arm", *resolve_profiles(ARM, "linear_4310"), WorkspaceConfig(collision_margin_m=0.01))]
    )
    assert clearance.parts.joints == [7] and clearance.parts.open_grippers([0.2])


# through the loop


@pytest.mark.long
def test_it_comes_up_holds_tracks_and_lands(rig):
    with arm_on(rig, FOLLOWER, **GAINS) as arm:
        before = arm.observe()
        assert before.q.shape == (7,) and len(before.positions) == 8 and before.temp_mos_c.shape == (8,)
        arm.clock.sleep(0.5)
        held = arm.observe()
        assert held.mode is Mode.HOLD and np.abs(held.q - before.q).max() < 0.02
        arm.move_to(REACH, gripper=0.3)
        with pytest.raises(ActionError, match=r"shape \(7,\)"):
            arm.command(REACH[:6])
        for _ in range(20):
            arm.command(REACH, 0.3, dq=np.zeros(7), kp=[20.0] * 7, kd=[1.0] * 7)
            arm.clock.sleep(0.02)
        state = arm.observe()
        assert state.mode is Mode.TRACK and np.abs(state.q - REACH).max() < 0.05 and abs(state.gripper - 0.3) < 0.02
        true = rig.state()["arms"][FOLLOWER]
        assert len(true["q"]) == 7 and np.abs(state.q - true["q"]).max() < 0.01
        moved, fastest = land_and_watch(rig, arm, FOLLOWER)
        assert moved < MOST_M and fastest < 0.75
        assert abs(true["q"][0] - rig.state()["arms"][FOLLOWER]["q"][0]) < 0.05  # the base stays turned


@pytest.mark.long
@pytest.mark.parametrize("named", [True, False])
def test_a_landing_that_is_barred_goes_round_with_the_joints_that_the_profile_names(rig, tmp_path, caplog, named):
    """The shoulder is jammed for a while. Without names there is no way round: it holds, and tries again."""
    profile = tmp_path / "arm.yaml"
    text = Path(ARM).read_text()
    profile.write_text(text if named else NAMED.sub(NOBODY, text))
    with arm_on(rig, FOLLOWER, **GAINS | {"arm": str(profile)}) as arm:
        arm.move_to([0.0, 1.0, 0.4, 0.0, 0.3, 0.0, 0.0])
        rig.fault(FOLLOWER, "joint_2", "stuck", True)
        port = arm._session[FOLLOWER]
        port.land()
        elbow, wrist = [], []
        for _ in range(120):
            arm.clock.sleep(0.05)
            elbow.append(port.published().q[2])
            wrist.append(port.published().q[4])
        assert ("goes round, over the top" in caplog.text) == named
        assert (max(elbow) > 1.1) == named  # it opens until the forearm is level
        assert "joint_2 is held, obstructed or carries too much; let go of it and keep clear" in caplog.text
        rig.fault(FOLLOWER, "joint_2", "stuck", False)
        arm.clock.sleep(15.0)
        assert port.mode() is Mode.OFF
        assert np.abs(rig.state()["arms"][FOLLOWER]["q"] - load_arm(ARM).rest_q_rad["linear_4310"]).max() < 0.1


def test_a_leader_with_a_handle_floats(rig):
    """Its joint 7 has the id that a YAM's gripper has: it is not taken for a follower's motor."""
    session = session_on(rig, sim_config(rig, LEADER, **GAINS))
    session.start()
    try:
        session.clock.sleep(0.5)
        state = session[LEADER].observe()
        assert state.mode is Mode.FLOAT and state.q.shape == (7,) and state.gripper is None and state.trigger == 0.0
    finally:
        session.discard()


def test_a_bare_wrist_is_not_taken_for_a_follower(tmp_path):
    with (
        contextlib.closing(LockstepRig(write_scene(tmp_path), gripper="no_gripper", arms=[FOLLOWER])) as rig,
        arm_on(rig, FOLLOWER, gripper="no_gripper", gripper_stops_rad=None, **GAINS) as arm,
    ):
        assert arm.observe().q.shape == (7,) and arm.observe().gripper is None


def test_its_motors_are_recognised(rig):
    arm = load_arm(ARM)
    with can.Bus(interface="yam_lockstep", channel=FOLLOWER, rig=rig.name) as bus:
        found = read_fingerprint(bus, FOLLOWER, "yam_lockstep", arm_ids(arm))
    assert sorted(found.motors) == [1, 2, 3, 4, 5, 6, 7, 8]
    assert "follower" in found.role(gripper_id(arm))


@pytest.mark.long
def test_gravity_is_carried(rig):
    """Of the whole arm: what the motors exert while they hold is what the model says."""
    with arm_on(rig, FOLLOWER, hold_integral=False, **GAINS) as arm:
        arm.move_to(REACH)
        arm.clock.sleep(1.0)
        state = arm.observe()
    expected = GravityModel(ARM, "linear_4310").torque(state.q)
    assert np.abs(expected).max() > 5.0
    np.testing.assert_allclose(state.tau_nm, expected, atol=0.6)
