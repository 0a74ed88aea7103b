"""Commander's model of an arm and its gripper, generated from the profiles: a URDF of one chain, and STL meshes.

    arm = ArmModel(arm, gripper)
    arm.write()          # …/yam.urdf and …/meshes/*.stl in the user's cache

The chain ends at the flange, which is the frame of the arm's last link. The gripper is a tool: its meshes are in the
flange frame with the fingers open, and Commander moves the fingers.
"""

import os
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from lerobot_robot_yam.arm.export.body_meshes import meshes, stl
from lerobot_robot_yam.arm.export.model_export import drawn_urdf
from lerobot_robot_yam.arm.export.primitives import Mesh, joined
from lerobot_robot_yam.arm.model import VISUAL_GROUP, build_spec
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import write_whole

MESHES = "meshes"
"""Name of the mesh folder beside the URDF, where both old and new versions of Commander look."""

_PACKAGE = "lerobot_robot_yam"


class Jaws(NamedTuple):
    """Finger motion in Commander: even meshes move by −axis · travel · position, odd meshes in the opposite direction.

    Position 0 is open, 1 closed.

    Attributes:
        axis: (3,) unit vector in the flange frame, along which the first finger opens.
        travel_m: travel of each finger.
    """

    axis: np.ndarray
    travel_m: float


class ArmModel:
    """Model files of one arm with its gripper.

    `arm`, `gripper`: resolved profiles, see `mounting.resolve_profiles`.

    Attributes:
        body_meshes: mesh file names of the gripper body, in the flange frame.
        jaw_meshes: mesh file names of the open fingers, in the order of `Jaws`; empty without fingers.
        jaws: finger motion, or None unless there are two fingers.
    """

    def __init__(self, arm: ArmProfile, gripper: GripperProfile):
        self._names = arm.name, gripper.name
        self.body_meshes: list[str] = []
        self.jaw_meshes: list[str] = []
        self.jaws: Jaws | None = None
        self._files: dict[str, bytes] = {}
        model = build_spec(arm, gripper).compile()
        self._add_arm(arm, model)
        self._add_tool(arm, gripper, model)

    @property
    def folder(self) -> Path:
        """Folder of the model files, which need not exist yet."""
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        return cache / _PACKAGE / f"waldo-{self._names[0]}-{self._names[1]}"

    @property
    def urdf_path(self) -> Path:
        return self.folder / f"{self._names[0]}.urdf"

    @property
    def mesh_dir(self) -> Path:
        return self.folder / MESHES

    def write(self) -> None:
        """Write missing or outdated files, each atomically. Raises ConfigError: a file cannot be written."""
        try:
            self.mesh_dir.mkdir(parents=True, exist_ok=True)
            for name, content in self._files.items():
                path = self.folder / name
                if not path.exists() or path.read_bytes() != content:
                    write_whole(path, content)
        except OSError as error:
            raise ConfigError(
                f"{self.folder} cannot be written ({error}); set XDG_CACHE_HOME to one that can"
            ) from error

    def _add_mesh(self, name: str, mesh: Mesh) -> str:
        file = f"{name}.stl"
        self._files[f"{MESHES}/{file}"] = stl(mesh)
        return file

    def _add_arm(self, arm: ArmProfile, model: mujoco.MjModel) -> None:
        links = {}
        for body in arm.bodies:
            drawn = enumerate(meshes(model, model.body(body.name).id, (VISUAL_GROUP,)))
            links[body.name] = {
                colour: f"package://{_PACKAGE}/{self._add_mesh(f'{body.name}_{i}', mesh)}"
                for i, (mesh, colour) in drawn
            }
        self._files[f"{arm.name}.urdf"] = drawn_urdf(arm, model, links).encode()

    def _add_tool(self, arm: ArmProfile, gripper: GripperProfile, model: mujoco.MjModel) -> None:
        """Add the gripper's meshes in the flange frame, with the fingers open."""
        data, travel = mujoco.MjData(model), gripper.finger_range_m
        if travel is not None:
            data.qpos[arm.joint_count :] = travel[1]
        mujoco.mj_kinematics(model, data)
        flange, ways = data.body(arm.bodies[-1].name), []
        turn = flange.xmat.reshape(3, 3)
        for body in gripper.bodies:
            place, drawn = data.body(body.name), meshes(model, model.body(body.name).id, (VISUAL_GROUP,))
            if body.joint is not None:
                ways.append(data.joint(body.joint.name).xaxis @ turn)
            if drawn:
                mesh = joined([mesh for mesh, _ in drawn])
                mesh = mesh.moved(turn.T @ place.xmat.reshape(3, 3), (place.xpos - flange.xpos) @ turn)
                file = self._add_mesh(f"{gripper.name}_{body.name}", mesh)
                (self.jaw_meshes if body.joint is not None else self.body_meshes).append(file)
        if travel is not None and len(ways) == len(self.jaw_meshes) == 2:
            closed, opened = travel.tolist()
            self.jaws = Jaws(ways[0] * np.sign(opened - closed), abs(opened - closed))
