"""A mobile base as part of the world: a chassis with four powered casters, whose wheels stand on the floor."""

import math
from collections.abc import Sequence

import mujoco

from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.mobile.base_profile import CASTERS, BaseProfile
from lerobot_robot_yam.mobile.rail_profile import RAIL_MOTOR
from lerobot_robot_yam.rig.scene.scene import BasePlacement, RailPlacement

# Our choices: the vendor publishes no masses. Sizes in m, half sizes as MuJoCo has them.
_CHASSIS_KG, _CASTER_KG, _WHEEL_KG = 50.0, 1.0, 0.8
CHASSIS_M, CHASSIS_UP_M = (0.28, 0.25, 0.09), 0.16
_WHEEL_HALF_WIDTH_M = 0.012
MOUNT_M = (0.10, 0.0, 0.69)  # mount in the frame of the base: at the height of a table top, z = 0 in the world
_COLUMN_KG, COLUMN_M = 6.0, (0.05, 0.12, 0.22)  # column between chassis and mount, below arms only
_PLATE_KG, PLATE_M = 3.0, (0.06, 0.31, 0.01)  # plate on which the arms stand
_MAST_M = (0.03, 0.06, 0.72)
_CARRIAGE_KG, _CARRIAGE_M = 15.0, (0.04, 0.10, 0.08)
_RAIL_RUB_N, _RAIL_DAMPING = 15.0, 20.0  # dry friction, N, and damping, N s/m, of the carriage
_RAIL_ROTOR_KG_M2 = 0.02  # rotor of the rail's motor behind its gear; estimated from the smaller types
_RAIL_SPARE_M = 0.03  # distance from each switch to the mechanical stop behind it
_GRIP = (1.0, 0.005, 0.0001)  # friction of rubber on a floor: sliding, torsion, rolling
_STEER_RUB, _DRIVE_RUB = 0.05, 0.05  # dry friction of steering and wheel, Nm


def add_base(spec: mujoco.MjSpec, row: BasePlacement, profile: BaseProfile, floor_z_m: float, arms: bool) -> None:
    """Add a base that stands on the floor. Names of its parts carry its channel: "base/rear_left_drive".

    arms: whether arms stand on the body "base/mount", which otherwise is only a frame.
    """
    x, y = row.position_m.tolist()
    half = row.yaw_rad / 2.0
    base = spec.worldbody.add_body(
        name=row.channel,
        pos=[x, y, floor_z_m + profile.radius_m],
        quat=[math.cos(half), 0.0, 0.0, math.sin(half)],
    )
    base.add_freejoint(name=row.channel)
    chassis = base.add_geom(name=f"{row.channel}/chassis", type=mujoco.mjtGeom.mjGEOM_BOX, size=CHASSIS_M)
    chassis.pos, chassis.mass, chassis.rgba = [0.0, 0.0, CHASSIS_UP_M], _CHASSIS_KG, [0.25, 0.27, 0.30, 1.0]
    for caster, h_x, h_y in zip(CASTERS, profile.h_x_m, profile.h_y_m, strict=True):
        _add_caster(spec, base, f"{row.channel}/{caster}", (h_x, h_y), profile)
    mount = base.add_body(name=f"{row.channel}/mount", pos=MOUNT_M)
    if arms:
        _add_box(mount, f"{row.channel}/plate", _PLATE_KG, PLATE_M, [0.0, 0.0, -PLATE_M[2]])
    if row.rail is not None:
        x, _, z = MOUNT_M
        _add_box(base, f"{row.channel}/mast", _COLUMN_KG, _MAST_M, [x - 0.15, 0.0, z + _MAST_M[2] - 0.44])
        _add_rail(spec, mount, row.channel, row.rail)
    elif arms:
        _add_box(mount, f"{row.channel}/column", _COLUMN_KG, COLUMN_M, [0.0, 0.0, -COLUMN_M[2]])


def _add_box(body: mujoco.MjsBody, name: str, kg: float, size: Sequence[float], at: Sequence[float]) -> mujoco.MjsGeom:
    box = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=size)
    box.pos, box.mass, box.rgba = at, kg, [0.55, 0.57, 0.60, 1.0]
    return box


def _add_rail(spec: mujoco.MjSpec, mount: mujoco.MjsBody, name: str, row: RailPlacement) -> None:
    """Let the mount slide on a vertical rail; it is placed at height 0."""
    slide = mount.add_joint(name=f"{name}/rail", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
    slide.range, slide.limited = [-_RAIL_SPARE_M, row.stroke_m + _RAIL_SPARE_M], mujoco.mjtLimited.mjLIMITED_TRUE
    slide.frictionloss, slide.damping = _RAIL_RUB_N, [_RAIL_DAMPING, 0.0, 0.0]
    slide.armature = _RAIL_ROTOR_KG_M2 / row.metres_per_rad**2
    brake = spec.add_equality(name=f"{name}/brake", type=mujoco.mjtEq.mjEQ_JOINT, name1=slide.name, active=False)
    brake.objtype = mujoco.mjtObj.mjOBJ_JOINT
    brake.solref[:], brake.solimp[:2] = [0.004, 1.0], 0.9999  # 200 N move a braked carriage by less than 0.1 mm
    carriage = _add_box(mount, f"{name}/carriage", _CARRIAGE_KG, _CARRIAGE_M, [-0.08, 0.0, -_CARRIAGE_M[2]])
    carriage.contype = carriage.conaffinity = 0
    servo = _add_servo(spec, slide, RAIL_MOTOR.type)
    servo.gear = [1.0 / row.metres_per_rad] + [0.0] * 5


def _add_caster(
    spec: mujoco.MjSpec, base: mujoco.MjsBody, name: str, at: tuple[float, float], profile: BaseProfile
) -> None:
    fork = base.add_body(name=f"{name}_fork", pos=[*at, 0.0])
    fork.mass, fork.inertia, fork.explicitinertial = _CASTER_KG, [2e-3, 2e-3, 2e-3], True
    steer = fork.add_joint(name=f"{name}_steer", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
    steer.frictionloss = _STEER_RUB
    wheel = fork.add_body(name=f"{name}_wheel", pos=[profile.b_x_m, profile.b_y_m, 0.0])
    drive = wheel.add_joint(name=f"{name}_drive", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0])
    drive.frictionloss = _DRIVE_RUB
    tyre = wheel.add_geom(name=f"{name}_tyre", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID)
    tyre.size = [profile.radius_m, _WHEEL_HALF_WIDTH_M, profile.radius_m]
    tyre.mass, tyre.friction, tyre.rgba = _WHEEL_KG, list(_GRIP), [0.08, 0.08, 0.08, 1.0]
    tyre.condim = 3
    for joint, kind in ((steer, profile.steer_type), (drive, profile.drive_type)):
        joint.armature = motor_type(kind).rotor_inertia_kg_m2 or 0.002
        _add_servo(spec, joint, kind)


def _add_servo(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, kind: str) -> mujoco.MjsActuator:
    """Add a motor's servo, which has the name of its joint."""
    most = motor_type(kind).torque_max_nm
    servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm = [1.0] + [0.0] * 9
    servo.forcelimited, servo.forcerange = True, [-most, most]
    return servo
