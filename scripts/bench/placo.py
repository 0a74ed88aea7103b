"""placo's inverse kinematics on our arms, for `bench_ik.py`: LeRobot's solver, given the same poses and starts.

pip install "placo<0.9.16" "cmeel-urdfdom<5"
"""

import math
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np

from lerobot_robot_yam.arm.kinematics import (
    ORIENTATION_TOLERANCE_RAD,
    POSITION_TOLERANCE_M,
    Starts,
    YamKinematics,
    pose_errors,
)
from lerobot_robot_yam.arm.model import build_model

SITE = "tcp_site"
_JOINTS = [f"joint{i + 1}" for i in range(6)]
_STEPS = 25  # at most from one start, as ours


def urdf(model: mujoco.MjModel) -> str:
    """The arm's kinematic chain with a link for the site: no masses, no shapes."""
    links, joints = [], []
    for body in range(1, model.nbody):
        if model.body_jntnum[body] and model.joint(model.body_jntadr[body]).name not in _JOINTS:
            continue  # fingers
        links.append(_name(model, body))
        origin = _origin(model.body_pos[body], model.body_quat[body])
        joints.append(_joint(model, body, origin))
    site = model.site(SITE).id
    links.append(SITE)
    joints.append(
        f'<joint name="to_{SITE}" type="fixed"><parent link="{_name(model, model.site_bodyid[site])}"/>'
        f'<child link="{SITE}"/>{_origin(model.site_pos[site], model.site_quat[site])}</joint>'
    )
    body = "".join(f'<link name="{link}"/>' for link in ("world_link", *links))
    return f'<robot name="arm">{body}{"".join(joints)}</robot>'


def _name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name if body else "world_link"


def _joint(model: mujoco.MjModel, body: int, origin: str) -> str:
    ends = f'<parent link="{_name(model, model.body_parentid[body])}"/><child link="{_name(model, body)}"/>{origin}'
    if not model.body_jntnum[body]:
        return f'<joint name="to_{_name(model, body)}" type="fixed">{ends}</joint>'
    index = model.body_jntadr[body]
    low, high = model.jnt_range[index].tolist()
    axis = " ".join(f"{value:.17g}" for value in model.jnt_axis[index])
    return (
        f'<joint name="{model.joint(index).name}" type="revolute">{ends}<axis xyz="{axis}"/>'
        f'<limit lower="{low:.17g}" upper="{high:.17g}" effort="100" velocity="100"/></joint>'
    )


def _origin(position_m: np.ndarray, quat_wxyz: np.ndarray) -> str:
    """URDF's R = Rz(yaw) Ry(pitch) Rx(roll)."""
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quat_wxyz / np.linalg.norm(quat_wxyz))
    r = flat.reshape(3, 3)
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if math.hypot(r[0, 0], r[1, 0]) > 1e-9:
        roll, yaw = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    else:
        roll, yaw = 0.0, math.atan2(-r[0, 1], r[1, 1])
    xyz = " ".join(f"{value:.17g}" for value in position_m)
    return f'<origin xyz="{xyz}" rpy="{roll:.17g} {pitch:.17g} {yaw:.17g}"/>'


class PlacoArm:
    """One arm in placo.

    Args:
        arm, gripper: profile names.
        steps: solver steps at most per start; 1 is how LeRobot's `RobotKinematics` calls it in a loop.

    Raises:
        ImportError: placo does not load here.
    """

    def __init__(self, arm: str, gripper: str, steps: int = _STEPS):
        import placo

        kinematics = YamKinematics(arm, gripper)
        with tempfile.TemporaryDirectory() as directory:
            path = Path(directory) / "arm.urdf"
            path.write_text(urdf(build_model(arm, gripper, visuals=False)))
            self._robot = placo.RobotWrapper(str(path))
        self._solver = placo.KinematicsSolver(self._robot)
        self._solver.mask_fbase(True)
        self._solver.enable_joint_limits(True)
        self._task = self._solver.add_frame_task(SITE, np.eye(4))
        self._task.configure(SITE, "soft", 1.0, 0.1)  # weights as ours: a radian counts as 0.1 m
        self._steps = steps
        self._starts = Starts(kinematics.fk, kinematics.lower, kinematics.upper)
        self._q = kinematics.middle
        off = max(np.abs(self._pose(q) - kinematics.fk(q)).max() for q in (kinematics.lower, kinematics.middle))
        assert off < 1e-6, f"placo's model of {arm} is off by {off}"

    def _pose(self, q: np.ndarray | None = None) -> np.ndarray:
        if q is not None:
            for name, value in zip(_JOINTS, q.tolist(), strict=True):
                self._robot.set_joint(name, value)
        self._robot.update_kinematics()
        return self._robot.get_T_world_frame(SITE)

    def _descend(self, target: np.ndarray, q: np.ndarray, deadline_s: float) -> bool:
        self._task.T_world_frame = target
        pose = self._pose(q)
        for _ in range(self._steps):
            try:
                self._solver.solve(True)
            except RuntimeError:  # its QP found no solution
                return False
            pose = self._pose()
            if _reached(pose, target) or time.monotonic() > deadline_s:
                break
        return _reached(pose, target)

    def find(self, target: np.ndarray, budget_s: float) -> tuple[bool, int]:
        """Whether a pose was found within the time, and the number of starts it took."""
        deadline_s, number = time.monotonic() + budget_s, 0
        for number, start in enumerate(self._starts.nearest(target, 64), 1):
            if self._descend(target, start, deadline_s):
                return True, number
            if time.monotonic() > deadline_s:
                break
        return False, number

    def begin(self, q: np.ndarray) -> None:
        """A path begins here."""
        self._q = q

    def follow(self, target: np.ndarray) -> bool:
        """The next pose of the path, from the solution before."""
        solved = self._descend(target, self._q, math.inf)
        self._q = np.array([self._robot.get_joint(name) for name in _JOINTS])
        return solved


def _reached(pose: np.ndarray, target: np.ndarray) -> bool:
    position_m, angle_rad = pose_errors(pose, target)
    return position_m <= POSITION_TOLERANCE_M and angle_rad <= ORIENTATION_TOLERANCE_RAD
