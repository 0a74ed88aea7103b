"""All arms of one control loop in one MuJoCo model, with their keep-out boxes and floors.

A part is one of: a shape of a link in the profile (the shapes are within 6 mm of the real surface), the convex hull of
all shapes of a link (accurate enough for most checks, and four times as fast), a keep-out box, or a floor. Parts are
identified by their geom ids.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.model import base_quat, build_spec
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile, Shape
from lerobot_robot_yam.errors import ConfigError

THING = -1
"""Owner of parts that belong to no arm: boxes and floors."""

_FLOOR_HALF_M = (2.0, 2.0, 0.5)  # half extents of the box that models a floor: MuJoCo has no distances to planes
_ACCURACY = (1e-10, 100)  # tolerance and iterations; MuJoCo's defaults cause 0.2 mm of noise in overlapping cylinders
_OPENING_STEP = 0.05  # rounding of openings, fraction of the stroke (2 mm of a finger), since measured ones fluctuate
_FAR_M = 10.0  # maximum distance that is measured, m
_TOUCH_M = 1e-9  # distance below which the direction between two parts is undefined, m
_HULL = "/hull"  # suffix of a hull's name
_CORNERS = 12  # corners of the polygon that replaces a circle


@dataclass(frozen=True)
class GuardedArm:
    """One arm of a control loop, with its mounted gripper and its workspace."""

    name: str
    arm: ArmProfile
    gripper: GripperProfile
    workspace: WorkspaceConfig
    tilt_rad: tuple[float, float] = (0.0, 0.0)


class ArmParts:
    """Parts of all arms, positioned by joint values.

    Args:
        arms: one or more arms with different names.

    Attributes:
        names: the arms' names.
        joints: number of joints of each arm; N is their sum.
        owner: per part, index of its arm, or `THING`.
        part_names: per part, its name in messages: "left link4", "keep-out 'camera mast'", "floor".
        body: per part, id of its link.
        link: per part, number of the arm's joints that move it; 0 for the base and for things.
        is_hull: per part, whether it is the hull of a link; an arm's other parts are shapes.
        radius: (parts,) radius of the bounding spheres around `centres`, m.
        levers: (parts, N) maximum distance between a point of the part and a joint's axis, m; 0 if the joint does not
            move the part.

    Raises:
        ConfigError: two arms have the same name, or a workspace is invalid.
    """

    def __init__(self, arms: Sequence[GuardedArm]):
        self.names = [arm.name for arm in arms]
        if len(set(self.names)) != len(arms):
            raise ConfigError(f"arms of one robot need different names, not {self.names}")
        for arm in arms:
            arm.workspace.check(arm.name)
        self.joints = [arm.arm.joint_count for arm in arms]
        self._model = model = _build(arms)
        self._data = mujoco.MjData(model)
        self.count = model.ngeom
        self.radius = model.geom_rbound.copy()
        joints = [(arm.name, f"joint{j + 1}") for arm in arms for j in range(arm.arm.joint_count)]
        self._joint_bodies = [int(model.joint(f"{arm}/{joint}").bodyid[0]) for arm, joint in joints]
        self._joint_index = np.array([self._qpos(*joint) for joint in joints], dtype=int)
        self._fingers = [[self._qpos(arm.name, joint) for joint in arm.gripper.finger_joints] for arm in arms]
        self._finger_range = [arm.gripper.finger_range_m for arm in arms]
        self.body = model.geom_bodyid.tolist()
        bodies = [model.body(body).name for body in self.body]
        self.part_names = [_part_name(model.geom(part).name, bodies[part]) for part in range(self.count)]
        self.owner = [next((i for i, n in enumerate(self.names) if b.startswith(f"{n}/")), THING) for b in bodies]
        self.is_hull = [model.geom(part).name.endswith(_HULL) for part in range(self.count)]
        self.levers = np.array([self._lever_row(part) for part in range(self.count)])
        self.link = [int(np.count_nonzero(row)) for row in self.levers]
        self._openings: list[float] = []
        self.open_grippers([1.0] * len(arms))
        self.place(np.zeros(len(joints)))

    def open_grippers(self, openings: Sequence[float]) -> bool:
        """Set the gripper openings, 0 closed … 1 open, one per arm; the next `place` moves the fingers.

        Openings are rounded up to a multiple of `_OPENING_STEP`. Return whether any opening has changed.
        """
        steps = [min(max(math.ceil(opening / _OPENING_STEP), 0) * _OPENING_STEP, 1.0) for opening in openings]
        if steps == self._openings:
            return False
        self._openings = steps
        for opening, fingers, travel in zip(steps, self._fingers, self._finger_range, strict=True):
            if travel is not None:
                self._data.qpos[fingers] = travel[0] + opening * (travel[1] - travel[0])
        return True

    def place(self, q: np.ndarray) -> None:
        """Move the arms to joint values (N,), rad, one arm after the other."""
        self._data.qpos[self._joint_index] = q
        mujoco.mj_kinematics(self._model, self._data)

    @property
    def centres(self) -> np.ndarray:
        """Centres (parts, 3) in the rig frame, m; a view that `place` updates."""
        return self._data.geom_xpos

    def distance(self, first: int, second: int, farthest_m: float = _FAR_M) -> float:
        """Measure the distance between two parts, m, up to `farthest_m`; negative: penetration depth."""
        return mujoco.mj_geomDistance(self._model, self._data, first, second, farthest_m, None)

    def distances(self, pairs: Sequence[tuple[int, int]]) -> list[float]:
        """Measure the distances of many pairs, m; slightly faster than `distance`."""
        model, data, measure = self._model, self._data, mujoco.mj_geomDistance
        return [measure(model, data, first, second, _FAR_M, None) for first, second in pairs]

    def distance_gradient(self, first: int, second: int, farthest_m: float) -> tuple[float, np.ndarray]:
        """Measure the distance between two parts, m, and its gradient with respect to the joints (N,), m/rad.

        ∇d = n · (J_2 − J_1), with unit vector n from the first part's nearest point to the second's. The gradient is 0
        beyond `farthest_m`, and for parts that just touch.
        """
        model, data, ends = self._model, self._data, np.zeros(6)
        distance = mujoco.mj_geomDistance(model, data, first, second, farthest_m, ends)
        if distance >= farthest_m or abs(distance) < _TOUCH_M:
            return distance, np.zeros(len(self._joint_index))
        mujoco.mj_comPos(model, data)
        jacobians = np.zeros((2, 3, model.nv))
        for jacobian, end, part in zip(jacobians, (ends[:3], ends[3:]), (first, second), strict=True):
            mujoco.mj_jac(model, data, jacobian, None, end, model.geom_bodyid[part])
        normal = (ends[3:] - ends[:3]) / distance
        return distance, (normal @ (jacobians[1] - jacobians[0]))[self._joint_index]

    def things_of(self, arm: int) -> list[int]:
        """List the boxes and the floor that limit this arm."""
        prefix = f"{self.names[arm]}/"
        things = [part for part in range(self.count) if self.owner[part] == THING]
        return [part for part in things if self._model.geom(part).name.startswith(prefix)]

    def floor_height(self, part: int) -> float | None:
        """Return the height of a floor, m; None if the part is no floor."""
        if self.owner[part] != THING or not self._model.geom(part).name.endswith("/floor"):
            return None
        return float(self._model.geom_pos[part][2] + self._model.geom_size[part][2])

    def _qpos(self, arm: str, joint: str) -> int:
        return int(self._model.joint(f"{arm}/{joint}").qposadr[0])

    def _lever_row(self, part: int) -> np.ndarray:
        """Compute chain lengths (N,) from each joint to the part's far end, m; 0: the joint does not move the part."""
        model, row = self._model, np.zeros(len(self._joint_bodies))
        length = float(np.linalg.norm(model.geom_pos[part]) + model.geom_rbound[part])
        body = int(model.geom_bodyid[part])
        while body:
            if body in self._joint_bodies:
                row[self._joint_bodies.index(body)] = length
            elif model.body_jntnum[body]:
                length += float(np.abs(model.jnt_range[model.body_jntadr[body]]).max())  # travel of a sliding finger
            length += float(np.linalg.norm(model.body_pos[body]))
            body = int(model.body_parentid[body])
        return row


def _part_name(geom: str, body: str) -> str:
    return geom.split("/", 1)[1] if body == "world" else body.replace("/", " ", 1)


def _build(arms: Sequence[GuardedArm]) -> mujoco.MjModel:
    """Build the model; names begin with the name of an arm: "left/link4", "left/keep-out 'camera mast'"."""
    spec = mujoco.MjSpec()
    spec.option.ccd_tolerance, spec.option.ccd_iterations = _ACCURACY
    world = spec.worldbody
    for arm in arms:
        place = arm.workspace
        frame = world.add_frame(pos=place.base_position_m, quat=base_quat(place.base_yaw_rad, arm.tilt_rad))
        spec.attach(_with_hulls(arm), prefix=f"{arm.name}/", frame=frame)
        for box in place.keep_out:
            geom = world.add_geom(name=f"{arm.name}/keep-out '{box.name}'", type=mujoco.mjtGeom.mjGEOM_BOX)
            geom.pos, geom.quat = box.center_m, base_quat(box.yaw_rad)
            geom.size = [extent / 2 for extent in box.size_m]
        if place.floor_z_m is not None:
            geom = world.add_geom(name=f"{arm.name}/floor", type=mujoco.mjtGeom.mjGEOM_BOX, size=_FLOOR_HALF_M)
            x, y, _ = place.base_position_m
            geom.pos = [x, y, place.floor_z_m - _FLOOR_HALF_M[2]]
    return spec.compile()


def _with_hulls(arm: GuardedArm) -> mujoco.MjSpec:
    """Build the arm's model with its shapes, and add the convex hull of each link."""
    spec = build_spec(arm.arm, arm.gripper)
    for row in (*arm.arm.bodies, *arm.gripper.bodies):
        corners = [_corners(shape) for shape in row.shapes if shape.colour != "none"]
        if corners:
            spec.add_mesh(name=f"{row.name}{_HULL}", uservert=np.concatenate(corners).ravel())
            hull = spec.body(row.name).add_geom(name=f"{row.name}{_HULL}", type=mujoco.mjtGeom.mjGEOM_MESH)
            hull.meshname = f"{row.name}{_HULL}"
            hull.mass = hull.density = 0.0
    return spec


def _corners(shape: Shape) -> np.ndarray:
    """Compute corners (k, 3), in the body's frame, of a polyhedron around the shape, at most 7 % of a radius larger."""
    if shape.kind in ("cylinder", "capsule"):
        turn = np.arange(_CORNERS) * 2 * np.pi / _CORNERS
        rise = np.radians([-90, -60, -30, 0, 30, 60, 90]) if shape.kind == "capsule" else np.zeros(1)
        turn, rise = (grid.ravel() for grid in np.meshgrid(turn, rise))
        local = np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1)
        local *= shape.radius_m / np.cos(np.pi / _CORNERS) ** (2 if shape.kind == "capsule" else 1)
        around = local @ _frame_along(shape.to_m - shape.from_m)
        return np.concatenate([shape.from_m + around, shape.to_m + around])
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, shape.quat_wxyz / np.linalg.norm(shape.quat_wxyz))
    halves = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * shape.size_m
    return shape.center_m + halves @ rotation.reshape(3, 3).T


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """Compute the rows (3, 3) of a right-handed frame whose third axis is `axis`."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
