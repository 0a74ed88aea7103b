"""MuJoCo model of a scene: arms with a servo per motor, things, cameras and scenery.

Each motor is one actuator with force  kp (u* − u) + kd (u̇* − u̇) + tau,  integrated implicitly in the velocity
(implicitfast): with an explicit kd at 1 ms the light wrist joints would limit-cycle. u is the joint angle; for the
gripper, u is the motor angle, which acts through a tendon over both fingers.
"""

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from lerobot_robot_yam.arm.model import Physics, base_quat, build_spec
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile import GripperProfile, Load
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.deviation import Deviation
from lerobot_robot_yam.rig.scene.props import Part, Thing
from lerobot_robot_yam.rig.scene.scene import ArmPlacement, Camera, Scene
from lerobot_robot_yam.rig.world.base_model import add_base

HAND_KP, HAND_KD = 200.0, 20.0  # stiffness, Nm/rad, and damping, Nm s/rad, of a hand's firm grip on a leader's joints
HAND_TORQUE_NM = 12.0  # maximum torque of the operator's hand at each joint
# solver impedance (MuJoCo's solimp) at which a braked shaft creeps at 5 mrad/s; with the default it creeps at 0.5 rad/s
FIRM_FRICTION = 0.999
TABLE, FLAT = "table top", "flat thing"  # name prefixes of materials whose textures the renderer draws (`render.shade`)
BALLAST = "ballast"  # body at each arm's tcp; `outer_forces.Ballast` sets its mass, initially 0
_FLAT_M = 0.002  # thickness below which things receive shadows like the table
_FLOOR_Z_M = -0.74  # height of the floor; the table top is at z = 0
_SHAPES = {"box": mujoco.mjtGeom.mjGEOM_BOX, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER}
_JOINTS = {"slide": mujoco.mjtJoint.mjJNT_SLIDE, "hinge": mujoco.mjtJoint.mjJNT_HINGE}


def build_world(scene: Scene, visible: bool = True) -> mujoco.MjModel:
    """Compile the world's model. Names of an arm's parts are prefixed with its channel: "follower_left/joint1".

    Each process of the rig that needs the model builds it from the scene, with an identical result. With visible=False
    the model lacks the shapes that only cameras see, and a step takes 10 % less time.

    Raises:
        ConfigError: a profile is unknown or incompatible.
    """
    spec = mujoco.MjSpec()
    spec.modelname = scene.name
    spec.compiler.degree = False
    spec.option.timestep = scene.options.timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0  # prevents held props from creeping out of the fingers
    add_scenery(spec)
    if scene.base is not None:
        add_base(spec, scene.base, scene.base.profile, _FLOOR_Z_M, any(row.on_base for row in scene.arms))
    for row in scene.arms:
        _attach_arm(spec, row, scene)
    add_things(spec, scene.things)
    if visible and scene.options.pictures == "full":
        add_shaded_surfaces(spec, scene.furniture)
    for camera in scene.cameras:
        _add_camera(spec, camera)
    spec.compiler.discardvisual = not visible
    return spec.compile()


def world_dtype(model: mujoco.MjModel) -> np.dtype:
    """Return the dtype of the world block: simulated and monotonic time in s, seed of the look, qpos, qvel."""
    fields = [("sim_s", "f8"), ("stamp_s", "f8"), ("look_seed", "i8")]
    return np.dtype([*fields, ("qpos", "f8", (model.nq,)), ("qvel", "f8", (model.nv,))])


def gripper_stroke(row: ArmPlacement, gripper: GripperProfile) -> tuple[float, float]:
    """Return the closed stop, rad, and the motor angle per summed finger travel, rad/m, both in joint space."""
    assert gripper.calibration is not None and gripper.finger_range_m is not None
    stops = gripper.calibration.nominal_stops_rad if row.stops_rad is None else row.stops_rad
    travel = float(gripper.finger_range_m[1] - gripper.finger_range_m[0])
    return float(stops[0]), float(stops[1] - stops[0]) / travel / max(1, len(gripper.finger_joints))


def yaw_quat(yaw_rad: float) -> np.ndarray:
    """Return the quaternion (4,), w x y z, of a rotation about the vertical."""
    return np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])


def add_things(spec: mujoco.MjSpec, things: Sequence[Thing]) -> None:
    """Add a body and, where needed, a joint per thing, with the thing's name; carriers before the things they carry."""
    for thing in sorted(things, key=lambda thing: bool(thing.carrier)):
        parent = spec.body(thing.carrier) if thing.carrier else spec.worldbody
        body = parent.add_body(name=thing.name, pos=thing.center_m, quat=yaw_quat(thing.yaw_rad))
        if (row := thing.joint) is not None:
            joint = body.add_joint(name=thing.name, type=_JOINTS[row.kind], axis=row.axis, pos=row.pivot_m)
            joint.range, joint.limited = row.range, mujoco.mjtLimited.mjLIMITED_TRUE
            joint.frictionloss, joint.damping = row.friction, [row.damping, 0.0, 0.0]
        elif not thing.fixed:
            body.add_freejoint(name=thing.name)
        solid_m3 = sum(part.volume_m3 for part in thing.all_parts if part.solid)
        for i, part in enumerate(thing.all_parts):
            _add_part(body, thing, part, f"{thing.name}_{i}" if i else thing.name, solid_m3)
        if thing.carrier:
            # MuJoCo excludes contacts between a body and its parent by default, unless the parent is fixed.
            spec.add_exclude(bodyname1=thing.carrier, bodyname2=thing.name)


def _add_part(body: mujoco.MjsBody, thing: Thing, part: Part, name: str, solid_m3: float) -> None:
    x, _, z = part.size_m / 2
    size = part.size_m / 2 if part.shape == "box" else [x, z, 0.0]
    geom = body.add_geom(name=name, type=_SHAPES[part.shape], size=size, pos=part.center_m, quat=part.quat_wxyz)
    geom.rgba = thing.rgba if part.rgba is None else part.rgba
    geom.friction = [thing.friction, 0.01, 0.0001]
    geom.condim = 4
    geom.mass = thing.mass_kg * part.volume_m3 / solid_m3 if part.solid else 0.0
    if not part.solid:
        geom.contype = geom.conaffinity = 0


def _add_camera(spec: mujoco.MjSpec, camera: Camera) -> None:
    body = spec.worldbody if not camera.body else spec.body(camera.body)
    if body is None:
        raise ConfigError(f"camera '{camera.name}': no body '{camera.body}'; bodies are named channel/body")
    backward = camera.position_m - camera.target_m
    backward = backward / np.linalg.norm(backward)
    right = np.cross(camera.up, backward)
    right /= np.linalg.norm(right)
    rotation = np.column_stack([right, np.cross(backward, right), backward])
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    body.add_camera(name=camera.name, pos=camera.position_m, quat=quat, fovy=camera.fovy_deg)


def carried(deviation: Deviation) -> Load:
    """Return the payload that an arm carries at its tool and that the arm's profile does not contain."""
    x, y, z = deviation.payload_com_m.tolist()
    return Load(payload_mass_kg=deviation.payload_mass_kg, payload_com_m=(x, y, z))


def _attach_arm(spec: mujoco.MjSpec, row: ArmPlacement, scene: Scene) -> None:
    physics = Physics(friction_scale=scene.options.friction, armature_scale=scene.options.armature)
    arm, gripper = resolve_profiles(row.arm, row.gripper)
    stand = spec.body(f"{scene.base.channel}/mount") if row.on_base and scene.base is not None else spec.worldbody
    frame = stand.add_frame(pos=row.position_m, quat=base_quat(row.yaw_rad, row.tilt_rad.tolist()))
    built, load = (arm, gripper), None
    if row.deviation is not None:
        built, load = row.deviation.apply(arm, gripper), carried(row.deviation)
    own = build_spec(*built, load=load, physics=physics)
    if row.deviation is not None:
        _add_rubbing(own, row.deviation, arm.joint_count)
    tcp = own.site("tcp_site")
    ballast = tcp.parent.add_body(name=BALLAST, pos=tcp.pos, explicitinertial=True, mass=0.0)
    ballast.inertia, ballast.ipos, ballast.iquat = [0.0] * 3, [0.0] * 3, [1.0, 0.0, 0.0, 0.0]
    spec.attach(own, prefix=f"{row.channel}/", frame=frame)
    for i, motor in enumerate(arm.motors):
        target = f"{row.channel}/joint{i + 1}"
        limit = motor_type(motor.type).torque_max_nm
        _add_servo(spec, f"{row.channel}/{motor.name}", target, mujoco.mjtTrn.mjTRN_JOINT, limit)
        if row.role == "leader":
            _add_servo(spec, f"{row.channel}/hand_{i + 1}", target, mujoco.mjtTrn.mjTRN_JOINT, HAND_TORQUE_NM)
    if gripper.motor is not None:
        target, coefficient = f"{row.channel}/gripper", gripper_stroke(row, gripper)[1]
        tendon = spec.add_tendon(name=target)
        for finger in gripper.finger_joints:
            tendon.wrap_joint(f"{row.channel}/{finger}", coefficient)
        limit = motor_type(gripper.motor.type).torque_max_nm
        _add_servo(spec, f"{row.channel}/{gripper.motor.name}", target, mujoco.mjtTrn.mjTRN_TENDON, limit)


def _add_rubbing(spec: mujoco.MjSpec, deviation: Deviation, joints: int) -> None:
    for i in range(joints):
        joint = spec.joint(f"joint{i + 1}")
        if deviation.friction is not None:
            joint.solimp_friction[:2] = FIRM_FRICTION
        if deviation.viscous_nm_s is not None:
            joint.damping = [deviation.viscous_nm_s[i], 0.0, 0.0]


def _add_servo(spec: mujoco.MjSpec, name: str, target: str, kind: mujoco.mjtTrn, limit_nm: float) -> None:
    actuator = spec.add_actuator(name=name, target=target, trntype=kind, gainprm=[1.0] + [0.0] * 9)
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    actuator.forcelimited, actuator.forcerange = True, [-limit_nm, limit_nm]


def add_scenery(spec: mujoco.MjSpec) -> None:
    """Add sky, floor and lights. The floor stops falling things; the rest has no contacts."""
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = [0.38] * 3, [0.22] * 3, [0.05] * 3
    spec.visual.map.znear = 0.01
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=32, height=192)
    sky.builtin, sky.rgb1, sky.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, [0.80, 0.87, 0.94], [0.42, 0.53, 0.66]
    floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[4.0, 4.0, 0.1])
    floor.pos = [0.0, 0.0, _FLOOR_Z_M]
    floor.rgba = [0.50, 0.53, 0.56, 1.0]
    for position, direction, level in (
        ([0.8, 0.8, 2.0], [-0.35, -0.4, -1.0], 0.45),
        ([-0.6, -1.0, 2.2], [0.3, 0.4, -1.0], 0.22),
    ):
        light = spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=position, dir=direction)
        light.diffuse, light.specular = [level, 0.97 * level, 0.92 * level], [0.15] * 3
        light.ambient, light.castshadow = [0.0] * 3, False


def add_shaded_surfaces(spec: mujoco.MjSpec, furniture: Sequence[Thing]) -> None:
    """Give the table, and flat furniture that never moves, materials whose textures the renderer redraws.

    The table is the largest fixed box whose top is at z = 0.
    """
    still = [thing for thing in furniture if thing.fixed and not thing.carrier]
    boxes = [(thing.name, thing.center_m[2], thing.size_m) for thing in still if thing.size_m is not None]
    areas = {name: float(x * y) for name, middle_z, (x, y, z) in boxes if abs(middle_z + z / 2) < 1e-6}
    if not areas:
        return
    _mark(spec.geom(max(areas, key=lambda name: areas[name])), spec, TABLE)
    for thing in still:
        for geom, part in zip(spec.body(thing.name).geoms, thing.all_parts, strict=True):
            if part.shape == "box" and part.size_m[2] < _FLAT_M:
                _mark(geom, spec, f"{FLAT} {geom.name}")


def _mark(geom: mujoco.MjsGeom, spec: mujoco.MjSpec, name: str) -> None:
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=8, height=8)  # placeholder
    texture.data = bytes([255]) * (8 * 8 * 3)
    spec.add_material(name=name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    geom.material = name
