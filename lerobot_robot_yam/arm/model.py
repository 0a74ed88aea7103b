"""MuJoCo models of an arm with its end effector, assembled from the profiles with MjSpec.

Without `physics` the model is the bare rigid-body tree, for gravity compensation and kinematics; published reference
values describe this tree. With `physics`, for the virtual rig, the model also has rotor inertia, friction, joint stops,
contacts and coupled fingers.

    scene.attach(build_spec("yam", "linear_4310", physics=Physics()), prefix="left_", frame=frame)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile import COLOURS, EE_BODY, ArmProfile, Body, GripperProfile, Inertial, Load, Shape
from lerobot_robot_yam.errors import ConfigError

# Coefficient of sliding friction between motor housings: coated metal, 0.2 … 0.4. With MuJoCo's default of 1 (rubber)
# a wrist that leans on the shoulder would lock the elbow.
_HOUSING_FRICTION = 0.3
_STOP_SOLREF = (0.005, 1.0)  # solref of joint stops: they give way by less than 1 mrad under the arm's weight

VISUAL_GROUP = 2
COLLISION_GROUP = 3  # group of invisible collision shapes; visible shapes that collide are in the visual group

_SHAPES = {
    kind: getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}") for kind in ("cylinder", "capsule", "box", "ellipsoid")
}
_GRIPPING = ("rubber", "soft")  # colours of finger pads, which get more friction than other shapes


@dataclass(frozen=True)
class Physics:
    """Physics that the virtual rig adds to the rigid-body tree. The scales multiply friction and armature."""

    friction_scale: float = 1.0
    armature_scale: float = 1.0
    collisions: bool = True


def base_quat(yaw_rad: float, tilt_rad: Sequence[float] = (0.0, 0.0)) -> np.ndarray:
    """Compute the quaternion (4,) w x y z of a base: roll about x, then pitch about y, then yaw about z of the world.

    The order of rotations is that of URDF's rpy. tilt_rad: [roll, pitch]; [1.57, 0] is a wall, [3.14, 0] a ceiling.
    """
    quat = np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])
    for angle, axis in ((tilt_rad[1], [0.0, 1.0, 0.0]), (tilt_rad[0], [1.0, 0.0, 0.0])):
        if angle:  # skipping zero angles keeps upright bases exact to the last bit
            turn, before = np.empty(4), quat.copy()
            mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
            mujoco.mju_mulQuat(quat, before, turn)
    return quat


def build_spec(
    arm: str | Path | ArmProfile,
    gripper: str | Path | GripperProfile,
    *,
    load: Load | None = None,
    physics: Physics | None = None,
    visuals: bool = True,
) -> mujoco.MjSpec:
    """Build the editable model with its base at the origin; `MjSpec.attach` adds it to a scene.

    Joints: joint1 … jointn, then those of the fingers (joint7 and joint8, or the next free numbers). Sites: tcp_site
    and, except for the teaching handle, grasp_site. Raises ConfigError: a name is unknown or a profile invalid.
    """
    arm, gripper = resolve_profiles(arm, gripper)
    load = load or Load()
    spec = mujoco.MjSpec()
    spec.modelname = f"{arm.name}_{gripper.name}"
    spec.compiler.degree = False
    bodies = {"world": spec.worldbody}
    for row in (*arm.bodies, *gripper.bodies):
        inertial = _ee_inertial(row.inertial, load) if row.name == EE_BODY else row.inertial
        bodies[row.name] = _add_body(bodies, row, inertial)
        for i, shape in enumerate(row.shapes if visuals or physics else ()):
            collisions = bool(physics and physics.collisions)
            _add_shape(bodies[row.name], shape, collisions=collisions, name=f"{row.name}_{i}")
    _add_joints(bodies, arm, gripper, physics)
    _add_payload(bodies, gripper, load)
    if physics and physics.collisions:
        _add_self_contacts(spec, arm)
    if physics and len(gripper.finger_joints) == 2:
        first, second = gripper.finger_joints
        coupling = spec.add_equality(
            name="fingers",
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=second,
            name2=first,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            solref=_STOP_SOLREF,
        )
        coupling.data[:5] = [0, 1, 0, 0, 0]  # second = first
    return spec


def build_model(arm: str, gripper: str, **options) -> mujoco.MjModel:
    """Build and compile the model; `options` as for `build_spec`."""
    return build_spec(arm, gripper, **options).compile()


def _add_body(bodies: dict[str, mujoco.MjsBody], row: Body, inertial: Inertial) -> mujoco.MjsBody:
    if row.name in bodies:
        raise ConfigError(f"body '{row.name}': arm and end effector both have a body of this name")
    if row.parent not in bodies:
        raise ConfigError(f"body '{row.name}': unknown parent '{row.parent}'; known so far: {sorted(bodies)}")
    body = bodies[row.parent].add_body(name=row.name, pos=row.pos_m, quat=row.quat_wxyz)
    body.explicitinertial = True
    body.mass, body.ipos = inertial.mass_kg, inertial.com_m
    body.iquat, body.inertia = inertial.quat_wxyz, inertial.moments_kg_m2
    for site in row.sites:
        body.add_site(name=site.name, pos=site.pos_m, quat=site.quat_wxyz, size=[0.004] * 3, group=4)
    return body


def _add_shape(body: mujoco.MjsBody, shape: Shape, *, collisions: bool, name: str) -> None:
    """Add a primitive geom without mass to `body`; it collides only if both `collisions` and the profile say so.

    Arm parts (contype 2, conaffinity 1) collide with MuJoCo's default objects (contype 1, conaffinity 1: table, props),
    but neither with each other nor with another arm, which saves most of the collision time of two arms. Links that
    must collide with each other are listed in the profile (`self_contacts`).
    """
    visible = shape.colour != "none"
    if not visible and not (collisions and shape.collides):
        return
    if shape.kind not in _SHAPES or (visible and shape.colour not in COLOURS):
        raise ConfigError(
            f"body '{body.name}': unknown shape '{shape.kind}' or colour '{shape.colour}'; "
            f"kinds {sorted(_SHAPES)}, colours {sorted(COLOURS)} or 'none'"
        )
    geom = body.add_geom(name=name, type=_SHAPES[shape.kind], mass=0.0, density=0.0)
    if shape.kind in ("cylinder", "capsule"):
        geom.fromto = np.concatenate([shape.from_m, shape.to_m])
        geom.size = [shape.radius_m, 0.0, 0.0]
    else:
        geom.pos, geom.quat, geom.size = shape.center_m, shape.quat_wxyz, shape.size_m / 2
    geom.rgba = COLOURS[shape.colour] if visible else (0.5, 0.5, 0.5, 0.3)
    geom.group = VISUAL_GROUP if visible else COLLISION_GROUP
    geom.contype, geom.conaffinity = (2, 1) if collisions and shape.collides else (0, 0)
    if shape.colour in _GRIPPING:
        geom.condim = 4
        geom.friction = [1.5, 0.02, 0.0001]  # rubber on wood, estimated; torsional friction for a flat pad
        geom.priority = 1
        # MuJoCo's soft default would let the gripper's heavy rotor sink 8 mm into a 50 g prop and squeeze it out.
        geom.solref, geom.solimp[:3] = [0.004, 1.0], [0.95, 0.99, 0.001]


def _add_joints(
    bodies: dict[str, mujoco.MjsBody], arm: ArmProfile, gripper: GripperProfile, physics: Physics | None
) -> None:
    kinds = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
    arm_rows = [row for row in arm.bodies if row.joint]
    for row in (*arm_rows, *(row for row in gripper.bodies if row.joint)):
        assert row.joint is not None
        if row.joint.kind not in kinds:
            raise ConfigError(f"joint '{row.joint.name}': kind must be hinge or slide, not '{row.joint.kind}'")
        joint = bodies[row.name].add_joint(name=row.joint.name, type=kinds[row.joint.kind], axis=row.joint.axis)
        if row in arm_rows:
            i = arm_rows.index(row)
            limits, armature, friction = arm.joint_limits_rad[i], arm.armature_kg_m2[i], arm.friction_nm[i]
        else:
            assert gripper.finger_range_m is not None
            limits = gripper.finger_range_m
            armature, friction = _finger_side(gripper)
        joint.range, joint.limited = limits, mujoco.mjtLimited.mjLIMITED_TRUE
        if physics:
            joint.armature = armature * physics.armature_scale
            joint.frictionloss = friction * physics.friction_scale
            joint.solref_limit = _STOP_SOLREF


def _add_self_contacts(spec: mujoco.MjSpec, arm: ArmProfile) -> None:
    rows = {row.name: row for row in arm.bodies}
    for pair in arm.self_contacts:
        if len(pair) != 2 or not set(pair) <= set(rows):
            raise ConfigError(f"arm '{arm.name}': self_contacts needs pairs of {sorted(rows)}, got {pair}")
        first, second = ([f"{name}_{i}" for i, s in enumerate(rows[name].shapes) if s.collides] for name in pair)
        for one in first:
            for other in second:
                contact = spec.add_pair(geomname1=one, geomname2=other, condim=3)
                contact.friction[:2] = _HOUSING_FRICTION


def _finger_side(gripper: GripperProfile) -> tuple[float, float]:
    """Compute armature, kg, and friction, N, of one finger: half of the motor's, reflected through the gearing.

    m = J (dθ/dx)² / 2,  F = τ (dθ/dx) / 2  with  dθ/dx = motor stroke / finger stroke  [rad/m].
    """
    if gripper.motor is None or gripper.finger_range_m is None:
        return 0.0, 0.0
    gearing = gripper.stroke_rad / float(np.ptp(gripper.finger_range_m))
    return gripper.motor.armature_kg_m2 * gearing**2 / 2, gripper.motor.friction_nm * gearing / 2


def _ee_inertial(inertial: Inertial, load: Load) -> Inertial:
    mass = inertial.mass_kg if load.ee_mass_kg is None else load.ee_mass_kg
    if load.ee_inertia is None:
        return Inertial(mass, inertial.com_m, inertial.quat_wxyz, inertial.moments_kg_m2)
    numbers = np.asarray(load.ee_inertia, dtype=np.float64)
    return Inertial(mass, numbers[:3], numbers[3:7], numbers[7:])


def _add_payload(bodies: dict[str, mujoco.MjsBody], gripper: GripperProfile, load: Load) -> None:
    if load.payload_mass_kg == 0.0:
        return
    (tcp,) = [site for row in gripper.bodies for site in row.sites if site.name == "tcp_site"]
    offset = np.empty(3)
    mujoco.mju_rotVecQuat(offset, np.array(load.payload_com_m), tcp.quat_wxyz / np.linalg.norm(tcp.quat_wxyz))
    body = bodies[EE_BODY].add_body(name="payload", pos=tcp.pos_m + offset)
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat = load.payload_mass_kg, [0, 0, 0], [1, 0, 0, 0]
    body.inertia = [1e-6 * load.payload_mass_kg] * 3  # a point mass, as nearly as MuJoCo allows
