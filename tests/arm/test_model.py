"""Models: names, looks within the real surfaces, no mass from looks, contacts only where declared."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.model import Physics, build_model, build_spec
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS, load_arm, load_gripper
from lerobot_robot_yam.errors import ConfigError

COMBINATIONS = [(arm, gripper) for arm in ARMS for gripper in GRIPPERS]
MOTORISED = [g for g in GRIPPERS if load_gripper(g).motor]


def names(model, kind, count):
    return [mujoco.mj_id2name(model, kind, i) for i in range(count)]


def in_scene(arm, gripper, physics):
    """The arm on a table plane at the height of its base."""
    scene = mujoco.MjSpec()
    scene.option.timestep = 0.001
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    scene.option.cone, scene.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0  # as the rig has it
    scene.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.1], pos=[0, 0, -0.1])
    spec = build_spec(arm, gripper, physics=physics)
    scene.attach(spec, prefix="arm_", frame=scene.worldbody.add_frame())
    return scene.compile()


@pytest.mark.parametrize(("arm", "gripper"), COMBINATIONS)
def test_names_and_size(arm, gripper):
    model = build_model(arm, gripper)
    joints = [f"joint{i}" for i in range(1, 7)] + list(load_gripper(gripper).finger_joints)
    assert names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt) == joints
    sites = names(model, mujoco.mjtObj.mjOBJ_SITE, model.nsite)
    assert sites == (["tcp_site"] if gripper == "yam_teaching_handle" else ["tcp_site", "grasp_site"])
    np.testing.assert_array_equal(model.jnt_range[:6], load_arm(arm).joint_limits_rad)
    assert not (model.dof_armature.any() or model.dof_frictionloss.any() or model.dof_damping.any())
    assert 15 <= model.ngeom <= 30  # looks like an arm, and renders fast


@pytest.mark.parametrize(("arm", "gripper"), COMBINATIONS)
def test_looks_carry_no_mass(arm, gripper):
    bare, full = build_model(arm, gripper, visuals=False), build_model(arm, gripper, physics=Physics())
    assert bare.ngeom == 0
    np.testing.assert_array_equal(bare.body_mass, full.body_mass)
    np.testing.assert_array_equal(bare.body_inertia, full.body_inertia)
    np.testing.assert_array_equal(bare.body_ipos, full.body_ipos)


def corners(shape):
    """Points on the hull of a shape, in its body's frame."""
    if shape.kind == "box":
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, shape.quat_wxyz / np.linalg.norm(shape.quat_wxyz))
        signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
        return shape.center_m + (signs * shape.size_m) @ rotation.reshape(3, 3).T
    axis = (shape.to_m - shape.from_m) / np.linalg.norm(shape.to_m - shape.from_m)
    side = shape.radius_m * np.sqrt(1 - axis**2)  # half the box of a disc normal to the axis
    return np.array([end + sign * side for end in (shape.from_m, shape.to_m) for sign in (-1, 1)])


@pytest.mark.parametrize(
    "body",
    [body for arm in ARMS for body in load_arm(arm).bodies if body.extents_m is not None]
    + [body for gripper in GRIPPERS for body in load_gripper(gripper).bodies if body.extents_m is not None],
    ids=lambda body: body.name,
)
def test_looks_fill_the_real_surface_and_stay_inside_it(body):
    points = np.concatenate([corners(shape) for shape in body.shapes if shape.colour != "none"])
    low, high = body.extents_m
    assert (points > low - 0.006).all() and (points < high + 0.006).all()
    size = np.ptp(points, axis=0)
    filled = size / (high - low)
    assert np.sort(filled)[1] > 0.75, (body.name, filled)  # two directions at least; finger carriages are left out


def test_gripper_alone_is_fixed_in_the_world():
    model = build_model("none", "linear_4310")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt) == ["joint7", "joint8"]
    np.testing.assert_allclose(data.site("grasp_site").xpos, [0.1347, 0.0, 0.1], atol=1e-5)
    np.testing.assert_allclose(data.site("tcp_site").xmat.reshape(3, 3)[:, 2], [1, 0, 0], atol=1e-5)


def test_two_arms_attach_to_one_scene():
    scene = mujoco.MjSpec()
    for side, y in (("left", 0.25), ("right", -0.25)):
        frame = scene.worldbody.add_frame(pos=[0, y, 0])
        scene.attach(build_spec("yam", "linear_4310", physics=Physics()), prefix=f"{side}_", frame=frame)
    model = scene.compile()
    assert model.nq == 16 and model.neq == 2
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    offset = data.body("left_gripper").xpos - data.body("right_gripper").xpos
    np.testing.assert_allclose(offset, [0, 0.5, 0], atol=1e-9)


@pytest.mark.parametrize("arm", ARMS)
def test_arm_touches_itself_only_where_declared(arm):
    model = build_model(arm, "linear_4310", physics=Physics())
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    declared = {frozenset(pair) for pair in load_arm(arm).self_contacts}
    for _ in range(100):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            pair = frozenset(model.body(model.geom_bodyid[g]).name for g in contact.geom)
            assert pair in declared


@pytest.mark.parametrize("gripper", MOTORISED)
def test_fingers_move_together_and_stop_at_their_ends(gripper):
    model = build_model("none", gripper, physics=Physics())
    data = mujoco.MjData(model)
    travel = load_gripper(gripper).finger_range_m[1]
    for force, end in ((60.0, travel), (-60.0, 0.0)):
        data.qfrc_applied[0] = force  # on one finger only
        for _ in range(3000):
            mujoco.mj_step(model, data)
            assert abs(data.qpos[0] - data.qpos[1]) < 1e-3
        np.testing.assert_allclose(data.qpos, end, atol=1e-3)


def test_physics_scales_friction_and_armature():
    arm = load_arm("yam")
    model = build_model("yam", "no_gripper", physics=Physics(friction_scale=0.0, armature_scale=2.0))
    assert not model.dof_frictionloss.any()
    np.testing.assert_allclose(model.dof_armature, 2 * arm.armature_kg_m2)
    model = build_model("yam", "no_gripper", physics=Physics(collisions=False))
    np.testing.assert_allclose(model.dof_frictionloss, arm.friction_nm)
    assert not (model.geom_contype.any() or model.geom_conaffinity.any() or model.npair)


def test_broken_profiles_are_refused():
    for overrides, complaint in (
        ({"self_contacts": [["link5", "elbow"]]}, "elbow"),
        ({"bodies": [{**document(load_arm("yam").bodies[0]), "parent": "moon"}], "motors": []}, "lengths"),
    ):
        with pytest.raises(ConfigError, match=complaint):
            build_spec(load_arm("yam", overrides), "no_gripper", physics=Physics())


def document(body):
    inertial = {k: np.asarray(v).tolist() for k, v in vars(body.inertial).items()}
    return {"name": body.name, "parent": body.parent, "inertial": inertial, "pos_m": [0] * 3, "quat_wxyz": [1, 0, 0, 0]}


@pytest.mark.parametrize(("arm", "gripper"), COMBINATIONS)
def test_cutting_torque_at_the_rest_pose_moves_nothing(arm, gripper):
    model = in_scene(arm, gripper, Physics())
    data = mujoco.MjData(model)
    data.qpos[:6] = load_arm(arm).rest_q(load_gripper(gripper))
    data.qpos[0] = 0.7  # joint 1 keeps any value
    mujoco.mj_forward(model, data)
    start = np.concatenate([data.xpos, data.xipos, data.site_xpos])
    moved = 0.0
    for _ in range(1500):
        mujoco.mj_step(model, data)
        now = np.concatenate([data.xpos, data.xipos, data.site_xpos])
        moved = max(moved, np.linalg.norm(now - start, axis=1).max())
    assert moved < 0.01


def test_zero_is_not_a_rest_pose():
    model = in_scene("yam", "linear_4310", Physics())
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.site("arm_grasp_site").xpos.copy()
    for _ in range(1500):
        mujoco.mj_step(model, data)
    assert np.linalg.norm(data.site("arm_grasp_site").xpos - start) > 0.03
