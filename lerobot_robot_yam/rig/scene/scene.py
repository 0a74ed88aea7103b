"""Scenes: arms with their CAN channels, things on the table, tasks, and options of the rig.

A scene is a YAML file, either packaged (`SCENES`) or provided by the user. A file with `extends: NAME` inherits each
key that it does not set, and each camera whose name it does not use. Each field of `options` can be overridden when
the rig starts: `RigControl.start(friction=0)`, `can.Bus(..., friction=0)`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_profile import BaseProfile
from lerobot_robot_yam.rig.scene.deviation import Deviation
from lerobot_robot_yam.rig.scene.props import Thing, check_things
from lerobot_robot_yam.rig.scene.tasks import PICK_AND_PLACE, SCRIPTS, Task, check_tasks
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.strict_yaml import array_field, merge, parse, read_yaml

_DIRECTORY = Path(__file__).parent / "scenes"
SCENES = tuple(sorted(path.stem for path in _DIRECTORY.glob("*.yaml")))
DEFAULT_SCENE = "bimanual_table"
ROLES = ("follower", "leader")
OPERATORS = ("none", PICK_AND_PLACE.name)  # operators available in any scene, besides the scene's scripted tasks
SERIALS = ("unique", "same")
PICTURES = ("full", "plain")
_TIMESTEPS_S = (1e-4, 0.01)
_ARM_SERIALS = 1000  # number of serial numbers reserved per arm


@dataclass(frozen=True, eq=False)
class ArmPlacement:
    """An arm on the table with its base at `position_m`, rotated by `yaw_rad` about the vertical.

    Attributes:
        on_base: whether the arm rides on the scene's mobile base; its placement is then in the frame of the mount.
        tilt_rad: [roll, pitch] of a base that does not stand upright, see `model.base_quat`.
        q_rad: initial pose (n,), default the rest pose.
        stops_rad: gripper stops [closed, open] in joint space (motor angle * direction), default from the profile.
        zero_offset_rad: motor angles at joint value 0, one per motor (gripper last), default 0.
        passive: station type (`passive_config`) of a leader without motors, whose joints are measured by encoders.
        deviation: differences between the arm and its profiles.
        number: number of the arm in the scene file, from 1, even if other arms are left out; set by `load_scene`.
    """

    channel: str
    role: str
    arm: str
    gripper: str
    position_m: np.ndarray = array_field(3)
    yaw_rad: float = 0.0
    on_base: bool = False
    tilt_rad: np.ndarray = array_field(2, default=(0, 0))
    q_rad: np.ndarray | None = array_field(-1, default=None)
    stops_rad: np.ndarray | None = array_field(2, default=None)
    zero_offset_rad: np.ndarray | None = array_field(-1, default=None)
    passive: str | None = None
    deviation: Deviation | None = None
    number: int = 0


@dataclass(frozen=True)
class RailPlacement:
    """A linear rail on a base, with motor 9, a brake and two switches.

    Attributes:
        height_m: initial height of the carriage above the lower switch, m.
        stroke_m: travel between the switches, m.
        metres_per_rad: travel per radian of the motor, m/rad.
        zero_rad: motor's angle at height 0, rad.
    """

    height_m: float = 0.0
    stroke_m: float = 1.0
    metres_per_rad: float = 0.03
    zero_rad: float = 2.0


@dataclass(frozen=True, eq=False)
class BasePlacement:
    """A mobile base on the floor, at `position_m` (x, y), turned by `yaw_rad` about the vertical.

    Attributes:
        steer_zero_rad: steering motors' angles when the casters point forward, default 0.
        rail: the linear rail that carries the mount; without, the mount is fixed.
        wheel_radius_m, track_factor: sizes that the driver does not know, see `BaseConfig`.
    """

    channel: str
    position_m: np.ndarray = array_field(2, default=(0, 0))
    yaw_rad: float = 0.0
    steer_zero_rad: np.ndarray = array_field(4, default=(0, 0, 0, 0))
    rail: RailPlacement | None = None
    wheel_radius_m: float = BaseProfile().radius_m
    track_factor: float = 1.0

    @property
    def profile(self) -> BaseProfile:
        """The base as it is built."""
        return BaseProfile().resized(self.wheel_radius_m, self.track_factor)


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at `position_m` that looks at `target_m`, both in the frame of `body` ("" is the world).

    up: direction that points up in the image. fovy_deg: vertical field of view.
    """

    name: str
    position_m: np.ndarray = array_field(3)
    target_m: np.ndarray = array_field(3)
    up: np.ndarray = array_field(3, default=(0, 0, 1))
    fovy_deg: float = 45.0
    body: str = ""


@dataclass(frozen=True)
class Options:
    """Options that can be set at each start of a rig.

    Attributes:
        arm, gripper: profiles that replace those of each follower, for tests of other hardware.
        arms: channels to simulate; None for all.
        friction, armature: factors on the profiles' dry friction and rotor inertia.
        rail: whether a base of the scene without a rail gets one.
        latency_s: delay of the CAN adapter in each direction, s.
        operator: task of the scripted operator: "none", "pick_and_place" or a task of the scene.
        swapped: two channels whose cables are exchanged: each of their arms replies on the other's channel.
        serials: contents of the SN registers: "unique", or "same" on each arm, so that no register tells arms apart.
        pictures: "full" has shadows and a grain on the table, "plain" has neither, for slow machines.
        randomise_look: spread, 0 … 1, of light, colours and camera poses, drawn with the seed of each attempt at a task
            (before the first attempt with `seed`), see `render.drawing`.
        camera_noise: standard deviation of the camera noise, grey levels.
        seed: seed of lost and garbled frames, temperature noise, the operator's first attempt at a task, and the
            positions in "pick_and_place".
    """

    arm: str | None = None
    gripper: str | None = None
    arms: tuple[str, ...] | None = None
    timestep_s: float = 0.001
    friction: float = 1.0
    armature: float = 1.0
    rail: bool = False
    latency_s: float = 0.0
    operator: str = "none"
    swapped: tuple[str, ...] | None = None
    serials: str = "unique"
    pictures: str = "full"
    randomise_look: float = 0.0
    camera_noise: float = 2.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Scene:
    """A complete scene.

    places: name → point (x, y, z), m, used by the operator's tasks. homes: side → waiting position (x, y, z), m, of
    the side's tool. Both are in the frame of the mount if the arms ride on a base. stands: name → pose (x, y, heading),
    m and rad, in the world, where the operator stops the base.
    """

    name: str
    arms: tuple[ArmPlacement, ...] = ()
    base: BasePlacement | None = None
    props: tuple[Thing, ...] = ()
    furniture: tuple[Thing, ...] = ()
    cameras: tuple[Camera, ...] = ()
    places: dict[str, np.ndarray] = array_field(3, default=None)
    homes: dict[str, np.ndarray] = array_field(3, default=None)
    stands: dict[str, np.ndarray] = array_field(3, default=None)
    tasks: tuple[Task, ...] = ()
    options: Options = Options()

    @property
    def channels(self) -> tuple[str, ...]:
        base = () if self.base is None else (self.base.channel,)
        return (*(arm.channel for arm in self.arms), *base)

    @property
    def things(self) -> tuple[Thing, ...]:
        return (*self.furniture, *self.props)


def load_scene(name: str | Path | None = None, options: Mapping[str, Any] | None = None) -> Scene:
    """Load the scene with this name (`SCENES`) or YAML path, with overridden options.

    Raises:
        ConfigError: a scene or option is unknown, or a value is invalid.
    """
    name = str(name or DEFAULT_SCENE)
    document = _document(name, Path())
    if "extends" in document:
        base = _document(str(document.pop("extends")), Path(name).parent)
        document = {**base, **document, "cameras": _cameras(base.get("cameras", []), document.get("cameras", []))}
    options = dict(options or {})
    for key in ("arms", "swapped"):
        if isinstance(options.get(key), str):
            options[key] = options[key].split(",")
    held = document.get("options") or {}
    if not isinstance(held, Mapping):
        raise ConfigError(f"scene '{name}': options expects a mapping, found {held!r}")
    scene = parse(Scene, merge(document, {"options": merge(held, options)}), f"scene '{name}'")
    _check(scene)
    _check_things(scene)
    scene = _selected(scene)
    for row in scene.arms:
        _check_placement(row)
    return scene


def _document(name: str, folder: Path) -> dict[str, Any]:
    """Read the file of a scene; a path is relative to `folder`."""
    if name in SCENES:
        return read_yaml(_DIRECTORY / f"{name}.yaml")
    if name.endswith((".yaml", ".yml")):
        return read_yaml(folder / user_path(name))
    raise ConfigError(f"unknown scene '{name}'; known: {', '.join(SCENES)}, or a path to a YAML file")


def _cameras(inherited: Any, own: Any) -> Any:
    """Return the inherited cameras, each replaced by an own camera of the same name, then the remaining own cameras.

    Wrong types are passed through, because `parse` rejects them.
    """
    if not (isinstance(inherited, list) and isinstance(own, list)):
        return own
    given = {str(row.get("name")): row for row in own if isinstance(row, Mapping)}
    kept = [given.get(str(row.get("name")), row) if isinstance(row, Mapping) else row for row in inherited]
    return kept + [row for row in own if row not in kept]


def _check(scene: Scene) -> None:
    where, options = f"scene '{scene.name}'", scene.options
    if len(set(scene.channels)) != len(scene.channels) or not scene.channels:
        raise ConfigError(f"{where}: needs arms or a base, each with another channel, not {scene.channels}")
    for arm in scene.arms:
        if arm.role not in ROLES:
            raise ConfigError(f"{where}: role of {arm.channel} must be one of {ROLES}, not '{arm.role}'")
        if arm.on_base and scene.base is None:
            raise ConfigError(f"{where}: {arm.channel} is on_base; add a base, or remove on_base")
        if arm.passive is not None and (arm.role != "leader" or arm.passive not in JOINT_SIGNS):
            raise ConfigError(f"{where}: {arm.channel}: passive is for leaders, and one of {', '.join(JOINT_SIGNS)}")
    operators = (*OPERATORS, *(task.name for task in scene.tasks if task.does in SCRIPTS))
    words = {"operator": operators, "serials": SERIALS, "pictures": PICTURES}
    for key, known in words.items():
        if getattr(options, key) not in known:
            raise ConfigError(f"{where}: option {key} must be one of {known}, not '{getattr(options, key)}'")
    if not _TIMESTEPS_S[0] <= options.timestep_s <= _TIMESTEPS_S[1]:
        raise ConfigError(f"{where}: option timestep_s must lie within {_TIMESTEPS_S}, not {options.timestep_s:g}")
    wrong = ["armature"] * (options.armature <= 0.0)
    wrong += [key for key in ("friction", "latency_s") if getattr(options, key) < 0.0]
    if wrong:
        raise ConfigError(
            f"{where}: options {wrong} are out of range: armature must be above zero, the others not below"
        )
    if not 0.0 <= options.randomise_look <= 1.0:
        raise ConfigError(f"{where}: option randomise_look must lie within 0 … 1, not {options.randomise_look:g}")
    for key, named in {"arms": options.arms, "swapped": options.swapped}.items():
        unknown = sorted(set(named or ()) - set(scene.channels))
        if unknown:
            raise ConfigError(f"{where}: option {key} names unknown channels {unknown}; known: {scene.channels}")
    if options.swapped is not None and len(set(options.swapped)) != 2:
        raise ConfigError(f"{where}: option swapped takes two channels, not {options.swapped}")


def _check_things(scene: Scene) -> None:
    """Raise ConfigError if a thing, task or camera is invalid."""
    where = f"scene '{scene.name}'"
    check_things(scene.props, scene.furniture, where)
    followers = [arm.channel for arm in scene.arms if arm.role == "follower"]
    check_tasks(scene.tasks, scene.things, followers, where)
    names = [camera.name for camera in scene.cameras]
    if len(set(names)) < len(names):
        raise ConfigError(f"{where}: cameras need unique names, not {names}")
    for camera in scene.cameras:
        if np.linalg.norm(np.cross(camera.position_m - camera.target_m, camera.up)) < 1e-9:
            raise ConfigError(f"{where}: camera {camera.name} needs a target_m elsewhere, not along its up direction")
        if not 0.0 < camera.fovy_deg < 180.0:
            raise ConfigError(f"{where}: camera {camera.name}: fovy_deg is between 0 and 180, not {camera.fovy_deg:g}")


def _check_placement(row: ArmPlacement) -> None:
    """Raise ConfigError if a pose, zero or stop does not match the arm and its gripper."""
    arm, gripper = load_arm(row.arm), load_gripper(row.gripper)
    motors = arm.joint_count + (gripper.motor is not None)
    for key, value, n in (("q_rad", row.q_rad, arm.joint_count), ("zero_offset_rad", row.zero_offset_rad, motors)):
        if value is not None and len(value) != n:
            raise ConfigError(f"{row.channel}: {key} takes {n} numbers, not {len(value)}")
    if row.stops_rad is not None and row.stops_rad[0] == row.stops_rad[1]:
        raise ConfigError(f"{row.channel}: stops_rad are [closed, open], two different angles")
    if row.deviation is not None:
        row.deviation.check(arm, gripper, row.channel)


def _selected(scene: Scene) -> Scene:
    """Apply the options swapped, arms, arm and gripper."""
    options = scene.options
    arms = []
    first, second = options.swapped or ("", "")
    exchanged = {first: second, second: first}
    for number, row in enumerate(scene.arms, 1):
        row = replace(row, number=number, channel=exchanged.get(row.channel, row.channel))
        if options.arms is not None and row.channel not in options.arms:
            continue
        if row.role == "follower":
            if options.arm is not None:
                row = replace(row, arm=options.arm, q_rad=None)
            if options.gripper is not None:
                row = replace(row, gripper=options.gripper, stops_rad=None, q_rad=None)
        arms.append(row)
    base = scene.base
    if options.rail and base is not None and base.rail is None:
        base = replace(base, rail=RailPlacement())
    kept = replace(scene, arms=tuple(arms), base=base)
    cameras = tuple(c for c in scene.cameras if not c.body or c.body.partition("/")[0] in kept.channels)
    return replace(kept, cameras=cameras)


def serial_number(scene: Scene, row: ArmPlacement, can_id: int) -> int:
    """Return the SN register of an arm's motor `can_id`: constant for a scene, and unique if `serials` is "unique"."""
    arm = row.number if scene.options.serials == "unique" else 1
    return arm * _ARM_SERIALS + can_id
