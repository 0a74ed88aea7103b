"""An arm and its gripper as Commander draws them: a URDF of one chain, and STL meshes, made from the profiles.

    arm = ArmModel(arm, gripper)
    arm.write()          # …/yam.urdf and …/meshes/*.stl in the user's cache; nothing when they are there already

The chain ends at the flange, the frame of the arm's last link. The gripper is a tool: its meshes lie in that frame, the
fingers open, and Commander slides them.
"""

import contextlib
import hashlib
import os
import shutil
import tempfile
import xml.etree.ElementTree as ET
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.profile import COLOURS, ArmProfile, Body, GripperProfile
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.waldo.kinematics.rotation import to_rpy
from lerobot_robot_yam.waldo.kinematics.serial_chain import frame_of, links
from lerobot_robot_yam.waldo.model.solids import stl, triangles

MESHES = "meshes"
"""Folder of the meshes beside the URDF: the one place where old and new Commander look."""

_PACKAGE = "lerobot_robot_yam"
_ROOT = "world"


class Jaws(NamedTuple):
    """How the fingers move as Commander tells it: the mesh i by −axis · travel · position, every second one the
    other way round; position 0 is open, 1 closed.

    Attributes:
        axis: (3,) of length 1, in the flange: the way on which the first finger opens.
        travel_m: of each finger.
    """

    axis: np.ndarray
    travel_m: float


class ArmModel:
    """Files of one arm with its gripper.

    Args:
        arm, gripper: resolved profiles, see `mounting.resolve_profiles`.

    Attributes:
        body_meshes: names of the files of the gripper's body, in the flange's frame.
        jaw_meshes: of its fingers, open, in the order of `Jaws`; none without fingers.
        jaws: None without two fingers.
    """

    def __init__(self, arm: ArmProfile, gripper: GripperProfile):
        self._arm, self._gripper = arm, gripper
        self.body_meshes: list[str] = []
        self.jaw_meshes: list[str] = []
        self.jaws: Jaws | None = None
        self._files: dict[str, bytes] = {}
        self._add_urdf()
        self._add_tool()

    @cached_property
    def folder(self) -> Path:
        """Where the files are, or will be; another one for each content."""
        digest = hashlib.sha256()
        for name, content in sorted(self._files.items()):
            digest.update(name.encode() + b"\0" + content)
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        return cache / _PACKAGE / f"waldo-{self._arm.name}-{digest.hexdigest()[:16]}"

    @property
    def urdf_path(self) -> Path:
        """Of the URDF."""
        return self.folder / f"{self._arm.name}.urdf"

    @property
    def mesh_dir(self) -> Path:
        """Of the meshes."""
        return self.folder / MESHES

    def write(self) -> None:
        """Write the files, all or none. Raises ConfigError: they cannot be written."""
        if self.folder.is_dir():
            return
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            scratch = Path(tempfile.mkdtemp(dir=self.folder.parent))
            (scratch / MESHES).mkdir()
            for name, content in self._files.items():
                (scratch / name).write_bytes(content)
            scratch.chmod(0o755)
            with contextlib.suppress(OSError):  # another process was quicker
                scratch.rename(self.folder)
            shutil.rmtree(scratch, ignore_errors=True)
        except OSError as error:
            raise ConfigError(
                f"{self.folder} cannot be written ({error}); set XDG_CACHE_HOME to one that can"
            ) from error

    def _add_mesh(self, name: str, corners: np.ndarray) -> str:
        file = f"{name}.stl"
        self._files[f"{MESHES}/{file}"] = stl(corners)
        return file

    def _add_urdf(self) -> None:
        arm = self._arm
        robot = ET.Element("robot", name=arm.name)
        for colour, rgba in COLOURS.items():
            material = ET.SubElement(robot, "material", name=colour)
            ET.SubElement(material, "color", rgba=_text(rgba))
        ET.SubElement(robot, "link", name=_ROOT)
        joint, parent = 0, _ROOT
        for body in links(arm):
            self._add_link(robot, body)
            turns = body.joint is not None
            name = arm.motors[joint].name if turns else f"{body.name}_mount"
            element = ET.SubElement(robot, "joint", name=name, type="revolute" if turns else "fixed")
            frame = frame_of(body)
            ET.SubElement(element, "origin", xyz=_text(frame[:3, 3]), rpy=_text(to_rpy(frame[:3, :3])))
            ET.SubElement(element, "parent", link=parent)
            ET.SubElement(element, "child", link=body.name)
            if body.joint is not None:
                ET.SubElement(element, "axis", xyz=_text(body.joint.axis / np.linalg.norm(body.joint.axis)))
                lower, upper = arm.joint_limits_rad[joint]
                limits = {
                    "lower": lower,
                    "upper": upper,
                    "effort": arm.torque_limit_nm[joint],
                    "velocity": arm.speed_limit_rad_s[joint],
                }
                ET.SubElement(element, "limit", {key: f"{value:.12g}" for key, value in limits.items()})
                joint += 1
            parent = body.name
        ET.indent(robot)
        text = f'<?xml version="1.0"?>\n{ET.tostring(robot, encoding="unicode")}\n'
        self._files[f"{arm.name}.urdf"] = text.encode()

    def _add_link(self, robot: ET.Element, body: Body) -> None:
        link = ET.SubElement(robot, "link", name=body.name)
        for colour, corners in _by_colour(body).items():
            visual = ET.SubElement(link, "visual")
            file = self._add_mesh(f"{body.name}_{colour}", corners)
            ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=f"package://{_PACKAGE}/{file}")
            ET.SubElement(visual, "material", name=colour)

    def _add_tool(self) -> None:
        """The gripper's meshes in the frame of the flange."""
        gripper, frames, fingers = self._gripper, {self._arm.bodies[-1].name: np.eye(4)}, []
        closed, opened = (0.0, 0.0) if gripper.finger_range_m is None else gripper.finger_range_m.tolist()
        for body in gripper.bodies:
            frame = frames[body.parent] @ frame_of(body)
            if body.joint is not None:
                way = frame[:3, :3] @ body.joint.axis
                fingers.append((body, way))
                frame = frame.copy()
                frame[:3, 3] += opened * way
            frames[body.name] = frame
            drawn = list(_by_colour(body).values())
            if drawn:
                corners = np.concatenate(drawn) @ frame[:3, :3].T + frame[:3, 3]
                file = self._add_mesh(f"{gripper.name}_{body.name}", corners)
                (self.jaw_meshes if body.joint is not None else self.body_meshes).append(file)
        if len(fingers) == 2 and len(self.jaw_meshes) == 2:
            axis = fingers[0][1] * np.sign(opened - closed)
            self.jaws = Jaws(axis / np.linalg.norm(axis), abs(opened - closed))


def _by_colour(body: Body) -> dict[str, np.ndarray]:
    """Triangles of the shapes that are seen, by colour."""
    found: dict[str, list[np.ndarray]] = {}
    for shape in body.shapes:
        if shape.colour != "none":
            found.setdefault(shape.colour, []).append(triangles(shape))
    return {colour: np.concatenate(parts) for colour, parts in found.items()}


def _text(numbers: np.ndarray | tuple[float, ...]) -> str:
    return " ".join(f"{number:.15g}" for number in numbers)
