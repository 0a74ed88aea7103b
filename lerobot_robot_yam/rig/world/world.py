"""The rig's physics: a MuJoCo world of a scene, kept at real time.

Every motor is one actuator with force  kp (u* − u) + kd (u̇* − u̇) + tau,  integrated implicitly in the velocity
(implicitfast), as an explicit kd at 1 ms would make the light wrist joints limit-cycle. u is the joint angle, or
the gripper motor's angle through a tendon over both fingers.
"""

import logging
import math

import mujoco
import numpy as np

from lerobot_robot_yam.arm.model import Physics, base_quat, build_spec
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.furnish import add_things
from lerobot_robot_yam.rig.scene.scene import ArmPlacement, Camera, Scene
from lerobot_robot_yam.rig.scene.scenery import add_scenery

logger = logging.getLogger(__name__)

HAND_KP, HAND_KD = 200.0, 20.0  # Nm/rad, Nm s/rad: a firm grip on the leader's joints
HAND_TORQUE_NM = 12.0  # what the operator's pull can do at a joint
_SLIP_S = 0.05  # further behind than this, simulated time is given up
_SLIP_TELL_S = 5.0  # between two log messages about it


def build_world(scene: Scene, visible: bool = True) -> mujoco.MjModel:
    """The compiled world. Names of an arm's parts carry its channel: "follower_left/joint1".

    Every process of the rig that needs the model builds it anew from the scene; the result is the same. Without
    `visible` it lacks the shapes that only a camera sees, and each step costs a tenth less.

    Raises:
        ConfigError: a profile is unknown or does not fit.
    """
    spec = mujoco.MjSpec()
    spec.modelname = scene.name
    spec.compiler.degree = False
    spec.option.timestep = scene.options.timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0  # held props must not creep out of the fingers
    add_scenery(spec)
    for row in scene.arms:
        _attach_arm(spec, row, scene)
    add_things(spec, scene.things)
    for camera in scene.cameras:
        _add_camera(spec, camera)
    spec.compiler.discardvisual = not visible
    return spec.compile()


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


def _attach_arm(spec: mujoco.MjSpec, row: ArmPlacement, scene: Scene) -> None:
    physics = Physics(friction_scale=scene.options.friction, armature_scale=scene.options.armature)
    arm, gripper = profiles_of(row)
    frame = spec.worldbody.add_frame(pos=row.position_m, quat=base_quat(row.yaw_rad, row.tilt_rad.tolist()))
    spec.attach(build_spec(arm, gripper, physics=physics), prefix=f"{row.channel}/", frame=frame)
    for i, motor in enumerate(arm.motors):
        target = f"{row.channel}/joint{i + 1}"
        limit = motor_type(motor.type).torque_max_nm
        _add_servo(spec, f"{row.channel}/{motor.name}", target, mujoco.mjtTrn.mjTRN_JOINT, limit)
        if row.role == "leader":
            _add_servo(spec, f"{row.channel}/hand_{i + 1}", target, mujoco.mjtTrn.mjTRN_JOINT, HAND_TORQUE_NM)
    if gripper.motor is not None:
        coefficient = gripper_stroke(row, gripper)[1]
        tendon = spec.add_tendon(name=f"{row.channel}/gripper")
        for joint in gripper.finger_joints:
            tendon.wrap_joint(f"{row.channel}/{joint}", coefficient)
        limit = motor_type(gripper.motor.type).torque_max_nm
        target = f"{row.channel}/gripper"
        _add_servo(spec, f"{row.channel}/{gripper.motor.name}", target, mujoco.mjtTrn.mjTRN_TENDON, limit)


def profiles_of(row: ArmPlacement) -> tuple[ArmProfile, GripperProfile]:
    """The arm, and its end effector as it is on that arm."""
    return resolve_profiles(row.arm, row.gripper)


def gripper_stroke(row: ArmPlacement, gripper: GripperProfile) -> tuple[float, float]:
    """(closed stop rad, radians per metre of one finger / 2), joint space."""
    assert gripper.calibration is not None and gripper.finger_range_m is not None
    stops = gripper.calibration.nominal_stops_rad if row.stops_rad is None else row.stops_rad
    travel = float(gripper.finger_range_m[1] - gripper.finger_range_m[0])
    return float(stops[0]), float(stops[1] - stops[0]) / travel / max(1, len(gripper.finger_joints))


def _add_servo(spec: mujoco.MjSpec, name: str, target: str, kind: mujoco.mjtTrn, limit_nm: float) -> None:
    spec.add_actuator(
        name=name,
        target=target,
        trntype=kind,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[1.0] + [0.0] * 9,
        forcelimited=True,
        forcerange=[-limit_nm, limit_nm],
    )


class World:
    """Model, state and simulated time. `qpos`, `qvel` and `force` are lists, fresh after each step.

    Attributes:
        sim_s: simulated time in s.
        stamp_s: monotonic time that the present state stands for.
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        self.model = build_world(scene, visible=False)
        self.data = mujoco.MjData(self.model)
        self.timestep_s = self.model.opt.timestep
        self.profiles: dict[str, tuple[ArmProfile, GripperProfile]] = {
            row.channel: profiles_of(row) for row in scene.arms
        }
        self._addresses = {row.channel: self._look_up(row.channel) for row in scene.arms}
        for row in scene.arms:
            arm, gripper = self.profiles[row.channel]
            self.set_pose(row.channel, arm.rest_q(gripper.name) if row.q_rad is None else row.q_rad)
        mujoco.mj_forward(self.model, self.data)
        self.slips = 0
        self.slipped_s = 0.0  # how far, the last time
        self._slip_told_s = -math.inf
        self._anchor_s = 0.0  # monotonic time of simulated time 0
        self.steps = 0
        self._tell_time()
        self.refresh()

    def start(self, now_s: float) -> None:
        """Simulated time runs from now on."""
        self._anchor_s = now_s - self.sim_s
        self._tell_time()

    def due(self, now_s: float) -> int:
        """Steps to do until now; gives time up (a slip) when too far behind."""
        behind = now_s - self.stamp_s
        if behind > _SLIP_S:
            self._anchor_s += behind
            self._tell_time()
            self.slips += 1
            self.slipped_s = behind
            if now_s - self._slip_told_s > _SLIP_TELL_S:
                self._slip_told_s = now_s
                logger.warning(
                    "physics fell %.0f ms behind (slip %d); simulated time is given up", behind * 1e3, self.slips
                )
            return 0
        return max(0, int(behind / self.timestep_s))

    def step(self, count: int) -> None:
        """Simulate `count` steps."""
        mujoco.mj_step(self.model, self.data, count)
        self.steps += count
        self._tell_time()
        self.refresh()

    def _tell_time(self) -> None:
        self.sim_s = self.steps * self.timestep_s
        self.stamp_s = self._anchor_s + self.sim_s

    def refresh(self) -> None:
        """Copy the state into plain lists: the motors read single numbers, which numpy makes slow."""
        self.qpos: list[float] = self.data.qpos.tolist()
        self.qvel: list[float] = self.data.qvel.tolist()
        self.force: list[float] = self.data.actuator_force.tolist()

    def asked_nm(self, actuators: np.ndarray) -> np.ndarray:
        """Torques  kp (u* − u) + kd (u̇* − u̇) + tau  of the last step in Nm, which the motors' own limits do not cut."""
        data, bias = self.data, self.model.actuator_biasprm[actuators]
        position, velocity = data.actuator_length[actuators], data.actuator_velocity[actuators]
        asked: np.ndarray = data.ctrl[actuators] + bias[:, 1] * position + bias[:, 2] * velocity
        return asked

    def _look_up(self, channel: str) -> tuple[list[int], list[int], list[int]]:
        """Where an arm is in the state; by name, which takes too long for whoever holds up the replies."""
        arm, gripper = self.profiles[channel]
        joints = [self.model.joint(f"{channel}/joint{i + 1}") for i in range(arm.joint_count)]
        fingers = [self.model.joint(f"{channel}/{name}") for name in gripper.finger_joints]
        return (
            [int(joint.qposadr[0]) for joint in joints],
            [int(joint.dofadr[0]) for joint in joints],
            [int(joint.qposadr[0]) for joint in fingers],
        )

    def joint_addresses(self, channel: str) -> list[int]:
        """Positions of an arm's joints in qpos."""
        return self._addresses[channel][0]

    def bodies(self, of: str = "") -> dict[str, list[float]]:
        """Position of each body whose name begins so, (3,) m."""
        names = [self.model.body(i).name for i in range(1, self.model.nbody)]
        return {name: self.data.body(name).xpos.tolist() for name in names if name.startswith(of)}

    def finger_addresses(self, channel: str) -> list[int]:
        """Positions of the fingers' joints in qpos."""
        return self._addresses[channel][2]

    def joint_dofs(self, channel: str) -> list[int]:
        """Positions of an arm's joints in qvel."""
        return self._addresses[channel][1]

    def opening(self, channel: str) -> float | None:
        """Gripper opening, 0 closed … 1 open; None without fingers."""
        _, gripper = self.profiles[channel]
        if gripper.finger_range_m is None:
            return None
        low, high = gripper.finger_range_m
        fingers = self.finger_addresses(channel)
        return float((sum(self.qpos[a] for a in fingers) / len(fingers) - low) / (high - low))

    def set_pose(self, channel: str, q_rad: np.ndarray | None = None, opening: float | None = None) -> None:
        """Teleport an arm (n,) rad and, 0 closed … 1 open, its fingers; at rest."""
        _, gripper = self.profiles[channel]
        moved = []
        if q_rad is not None:
            addresses = self.joint_addresses(channel)
            if len(q_rad) != len(addresses):
                raise ConfigError(f"{channel} has {len(addresses)} joints, the pose {len(q_rad)}")
            self.data.qpos[addresses] = q_rad
            moved += addresses
        if opening is not None and gripper.finger_range_m is not None:
            low, high = gripper.finger_range_m
            addresses = self.finger_addresses(channel)
            self.data.qpos[addresses] = low + opening * (high - low)
            moved += addresses
        joints = [j for j in range(self.model.njnt) if self.model.jnt_qposadr[j] in moved]
        self.data.qvel[self.model.jnt_dofadr[joints]] = 0.0

    def put(self, prop: str, position_m: np.ndarray, quat_wxyz: np.ndarray) -> None:
        """Teleport a loose thing (3,), (4,); at rest."""
        joint = self.data.joint(prop)
        joint.qpos[:] = [*position_m, *(quat_wxyz / np.linalg.norm(quat_wxyz))]
        joint.qvel[:] = 0.0

    def set_joint(self, thing: str, position: float) -> None:
        """Teleport a jointed thing to a position of its joint, m or rad; at rest."""
        joint = self.data.joint(thing)
        joint.qpos[:], joint.qvel[:] = position, 0.0

    def state_dtype(self) -> np.dtype:
        """Layout of the block that shows the world to renderers and operators."""
        return world_dtype(self.model)


def world_dtype(model: mujoco.MjModel) -> np.dtype:
    """One record of the world block: simulated and monotonic time in s, qpos, qvel."""
    return np.dtype([("sim_s", "f8"), ("stamp_s", "f8"), ("qpos", "f8", (model.nq,)), ("qvel", "f8", (model.nv,))])
