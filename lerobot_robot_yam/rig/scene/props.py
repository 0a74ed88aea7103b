"""Things in a scene file: built from boxes and cylinders, and fixed, loose or jointed."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.strict_yaml import array_field

SHAPES = ("box", "cylinder")
JOINT_KINDS = ("slide", "hinge")


@dataclass(frozen=True, eq=False)
class Part:
    """One box or upright cylinder of a thing, in the thing's frame.

    size_m: full size along x, y, z; for a cylinder: diameter, diameter, length along z. rgba: None for the thing's
    rgba. solid: False for a part that is visible but has no contacts.
    """

    size_m: np.ndarray = array_field(3)
    center_m: np.ndarray = array_field(3, default=(0.0, 0.0, 0.0))
    quat_wxyz: np.ndarray = array_field(4, default=(1.0, 0.0, 0.0, 0.0))
    shape: str = "box"
    rgba: np.ndarray | None = array_field(4, default=None)
    solid: bool = True

    @property
    def volume_m3(self) -> float:
        """Volume, m³; a thing's mass is distributed over its parts by volume."""
        return float(np.prod(self.size_m)) * (math.pi / 4 if self.shape == "cylinder" else 1.0)


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint between a thing and its carrier or the table, along or about `axis` through `pivot_m` in the thing's frame.

    range: minimum and maximum position, m for a slide, rad for a hinge; the initial position is 0. friction: N or Nm.
    damping: N s/m or Nm s/rad.
    """

    kind: str
    axis: np.ndarray = array_field(3)
    range: np.ndarray = array_field(2)
    pivot_m: np.ndarray = array_field(3, default=(0.0, 0.0, 0.0))
    friction: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True, eq=False)
class Grip:
    """Grasp point in a thing's frame; the fingers close along the frame's y axis, rotated by `yaw_rad`.

    turns: number of equivalent grasps in a full turn: 4 for a cube, 2 for a bar.
    """

    name: str
    point_m: np.ndarray = array_field(3, default=(0.0, 0.0, 0.0))
    yaw_rad: float = 0.0
    turns: int = 2


@dataclass(frozen=True, eq=False)
class Thing:
    """A prop or a piece of furniture: a box of `size_m`, `parts`, or both, with its frame at `center_m`.

    carrier: name of the thing that carries this one and in whose frame `center_m` and `yaw_rad` are given; a carried
    thing needs a joint. friction: sliding coefficient. mass_kg: 0 for a fixed thing.
    """

    name: str
    center_m: np.ndarray = array_field(3)
    yaw_rad: float = 0.0
    size_m: np.ndarray | None = array_field(3, default=None)
    parts: tuple[Part, ...] = ()
    rgba: np.ndarray = array_field(4, default=(0.7, 0.7, 0.7, 1.0))
    friction: float = 1.0
    mass_kg: float = 0.0
    carrier: str = ""
    joint: Joint | None = None
    grips: tuple[Grip, ...] = ()

    @property
    def all_parts(self) -> tuple[Part, ...]:
        """The box of `size_m`, if any, followed by `parts`."""
        return self.parts if self.size_m is None else (Part(self.size_m), *self.parts)

    @property
    def fixed(self) -> bool:
        return self.mass_kg == 0.0


def check_things(props: Sequence[Thing], furniture: Sequence[Thing], where: str) -> None:
    """Raise ConfigError if a thing cannot be simulated."""
    things = (*furniture, *props)
    names = [thing.name for thing in things]
    if len(set(names)) < len(names) or not all(names):
        raise ConfigError(f"{where}: props and furniture need unique, non-empty names, not {names}")
    carriers = [thing.name for thing in things if not thing.carrier]
    for thing in things:
        _check_thing(thing, thing in props, carriers, f"{where}: {thing.name}")


def _check_thing(thing: Thing, prop: bool, carriers: Collection[str], where: str) -> None:
    if thing.friction < 0.0 or thing.mass_kg < 0.0:
        raise ConfigError(f"{where}: friction and mass_kg cannot be below zero")
    if prop and (thing.fixed or thing.joint is not None):
        raise ConfigError(f"{where}: a prop has a mass above zero and is loose; else it is furniture")
    if not prop and thing.fixed != (thing.joint is None):
        raise ConfigError(f"{where}: furniture has a joint and a mass above zero, or neither")
    if thing.carrier and (thing.joint is None or thing.carrier not in carriers):
        raise ConfigError(f"{where}: carrier names a thing without one, and asks for a joint, not '{thing.carrier}'")
    if not thing.all_parts or not (thing.fixed or any(part.solid for part in thing.all_parts)):
        raise ConfigError(f"{where}: needs a size_m or parts; if something moves it, one must be solid")
    for part in thing.all_parts:
        _check_part(part, where)
    if thing.joint is not None:
        _check_joint(thing.joint, where)
    grips = [grip.name for grip in thing.grips]
    if len(set(grips)) < len(grips) or any(grip.turns < 1 for grip in thing.grips):
        raise ConfigError(f"{where}: grips need unique names, and one or more turns")


def _check_part(part: Part, where: str) -> None:
    if part.shape not in SHAPES:
        raise ConfigError(f"{where}: a part's shape is one of {SHAPES}, not '{part.shape}'")
    if (part.size_m <= 0.0).any():
        raise ConfigError(f"{where}: sizes must be above zero, not {part.size_m}")
    if part.shape == "cylinder" and part.size_m[0] != part.size_m[1]:
        raise ConfigError(f"{where}: a cylinder's size_m is diameter, diameter, length, not {part.size_m}")
    if not np.linalg.norm(part.quat_wxyz) > 0.0:
        raise ConfigError(f"{where}: quat_wxyz cannot be all zero")


def _check_joint(joint: Joint, where: str) -> None:
    if joint.kind not in JOINT_KINDS:
        raise ConfigError(f"{where}: a joint's kind is one of {JOINT_KINDS}, not '{joint.kind}'")
    if not np.linalg.norm(joint.axis) > 0.0:
        raise ConfigError(f"{where}: a joint's axis cannot be all zero")
    low, high = joint.range
    if not (low <= 0.0 <= high and low < high):
        raise ConfigError(f"{where}: a joint's range is [least, largest] with 0 in it, not {joint.range}")
    if joint.friction < 0.0 or joint.damping < 0.0:
        raise ConfigError(f"{where}: a joint's friction and damping cannot be below zero")
