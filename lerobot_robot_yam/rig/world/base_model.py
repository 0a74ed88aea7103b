"""A mobile base as part of the world: a chassis with four powered casters, whose wheels stand on the floor."""

import math

import mujoco

from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.mobile.base_profile import CASTERS, BaseProfile
from lerobot_robot_yam.rig.scene.scene import BasePlacement

# Our choices: the vendor publishes no masses. Sizes in m, half sizes as MuJoCo has them.
_CHASSIS_KG, _CASTER_KG, _WHEEL_KG = 50.0, 1.0, 0.8
_CHASSIS_M, _CHASSIS_UP_M = (0.28, 0.25, 0.09), 0.16
_WHEEL_HALF_WIDTH_M = 0.012
_MOUNT_M = (0.10, 0.0, 0.69)  # mount in the frame of the base: at the height of a table top, z = 0 in the world
_COLUMN_KG, _COLUMN_M = 6.0, (0.05, 0.12, 0.22)  # column between chassis and mount, below arms only
_PLATE_KG, _PLATE_M = 3.0, (0.06, 0.31, 0.01)  # plate on which the arms stand
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
    chassis = base.add_geom(name=f"{row.channel}/chassis", type=mujoco.mjtGeom.mjGEOM_BOX, size=_CHASSIS_M)
    chassis.pos, chassis.mass, chassis.rgba = [0.0, 0.0, _CHASSIS_UP_M], _CHASSIS_KG, [0.25, 0.27, 0.30, 1.0]
    for caster, h_x, h_y in zip(CASTERS, profile.h_x_m, profile.h_y_m, strict=True):
        _add_caster(spec, base, f"{row.channel}/{caster}", (h_x, h_y), profile)
    mount = base.add_body(name=f"{row.channel}/mount", pos=_MOUNT_M)
    if arms:
        for name, kg, size in (("column", _COLUMN_KG, _COLUMN_M), ("plate", _PLATE_KG, _PLATE_M)):
            part = mount.add_geom(name=f"{row.channel}/{name}", type=mujoco.mjtGeom.mjGEOM_BOX, size=size)
            part.pos, part.mass, part.rgba = [0.0, 0.0, -size[2]], kg, [0.55, 0.57, 0.60, 1.0]


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
        row = motor_type(kind)
        joint.armature = row.rotor_inertia_kg_m2 or 0.002
        servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        servo.gainprm = [1.0] + [0.0] * 9
        servo.forcelimited, servo.forcerange = True, [-row.torque_max_nm, row.torque_max_nm]
