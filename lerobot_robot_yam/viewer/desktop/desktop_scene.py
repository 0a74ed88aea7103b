"""The arms of a desktop window as one MuJoCo model, posed from outside; nothing in it is simulated."""

from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from lerobot_robot_yam.arm.model import build_spec
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.rig.world.world_model import add_scenery
from lerobot_robot_yam.viewer.live.placement import row_of

_GRIP_M = 0.045  # half the edge of the box that is dragged; the motor of a gripper, 36 mm, is inside
_GRIP_RGBA = (0.95, 0.5, 0.1, 0.5)


class DesktopScene:
    """Model and data for MuJoCo's viewer.

    Args:
        arms: by the key of their channel.
        grips: keys of the arms that get a box to drag their tool by.

    Attributes:
        model, data: of the viewer.
    """

    def __init__(self, arms: Mapping[str, ResolvedArm], grips: Collection[str] = ()):
        spec = mujoco.MjSpec()
        spec.modelname = "yam-view"
        spec.compiler.degree = False
        spec.option.gravity = [0.0, 0.0, 0.0]
        add_scenery(spec)
        self._arms = dict(sorted(arms.items()))
        self._bases: dict[str, np.ndarray] = {}
        for (key, hardware), (position, quat) in zip(self._arms.items(), row_of(self._arms.values()), strict=True):
            self._bases[key] = _pose(position, quat)
            frame = spec.worldbody.add_frame(pos=position, quat=quat)
            spec.attach(build_spec(hardware.arm, hardware.gripper), prefix=f"{key}/", frame=frame)
        for key in grips:
            if key in self._arms:
                grip = spec.worldbody.add_body(name=_grip(key), mocap=True)
                grip.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX, size=[_GRIP_M] * 3, rgba=_GRIP_RGBA, contype=0, conaffinity=0
                )
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def show(self, key: str, q: np.ndarray, gripper: float | None = None) -> None:
        """Pose an arm by its joints (n,) rad and its gripper 0 closed … 1 open; `refresh` follows."""
        hardware, values = self._arms[key], self.data.qpos
        first = int(self.model.joint(f"{key}/joint1").qposadr[0]) if hardware.joints else 0
        values[first : first + hardware.joints] = np.nan_to_num(q)
        travel = hardware.gripper.finger_range_m
        if travel is not None:
            closed, opened = travel
            opening = float(np.clip(np.nan_to_num(gripper or 0.0), 0.0, 1.0))
            for finger in hardware.gripper.finger_joints:
                values[self.model.joint(f"{key}/{finger}").qposadr[0]] = closed + opening * (opened - closed)

    def refresh(self) -> None:
        """Bring everything that follows from the joints up to date."""
        mujoco.mj_forward(self.model, self.data)

    def tool(self, key: str) -> np.ndarray:
        """(4, 4) pose of tcp_site in the frame of the arm's base, as of the last `refresh`."""
        site = self.data.site(f"{key}/tcp_site")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        return np.linalg.inv(self._bases[key]) @ pose

    def grip(self, key: str) -> np.ndarray:
        """(4, 4) pose of the box that is dragged, in the frame of the arm's base."""
        number = self._mocap(key)
        return np.linalg.inv(self._bases[key]) @ _pose(self.data.mocap_pos[number], self.data.mocap_quat[number])

    def put_grip(self, key: str, pose: np.ndarray) -> None:
        """Put that box at a pose (4, 4) in the frame of the arm's base."""
        number, place, quat = self._mocap(key), self._bases[key] @ pose, np.empty(4)
        mujoco.mju_mat2Quat(quat, place[:3, :3].ravel())
        self.data.mocap_pos[number], self.data.mocap_quat[number] = place[:3, 3], quat

    def _mocap(self, key: str) -> int:
        return int(self.model.body(_grip(key)).mocapid[0])


def _grip(key: str) -> str:
    return f"drag {key}"


def _pose(position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    turn, pose = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(turn, np.asarray(quat, dtype=float))
    pose[:3, :3], pose[:3, 3] = turn.reshape(3, 3), position
    return pose
