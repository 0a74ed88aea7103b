"""Scenes: which arms stand where on which CAN channel, what lies on the table, and the rig's options.

A scene is a YAML file, packaged (`SCENES`) or one's own. Any field of its `options` can be replaced when the rig is
started: `--set friction=0`, `RigControl.start(friction=0)`, `can.Bus(..., friction=0)`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.yaml_fields import array_field, merge, parse, read_yaml
from lerobot_robot_yam.errors import ConfigError

_DIRECTORY = Path(__file__).parent / "scenes"
SCENES = tuple(sorted(path.stem for path in _DIRECTORY.glob("*.yaml")))
DEFAULT_SCENE = "bimanual_table"
ROLES = ("follower", "leader")
OPERATORS = ("none", "pick_and_place")
WATCHDOGS = ("limp", "damping")


@dataclass(frozen=True, eq=False)
class ArmPlacement:
    """An arm on the table. Base at `position_m`, turned by `yaw_rad` about the vertical.

    q_rad: start pose (n,), default the rest pose. stops_rad: gripper stops [closed, open] in joint space (motor
    angle * direction), default the profile's. zero_offset_rad: motor angle at joint value 0, per motor (gripper
    last), default 0.
    """

    channel: str
    role: str
    arm: str
    gripper: str
    position_m: np.ndarray = array_field(3)
    yaw_rad: float = 0.0
    q_rad: np.ndarray | None = array_field(-1, default=None)
    stops_rad: np.ndarray | None = array_field(2, default=None)
    zero_offset_rad: np.ndarray | None = array_field(-1, default=None)


@dataclass(frozen=True, eq=False)
class Box:
    """A box of full size `size_m` with its centre at `center_m`; `friction` is the sliding coefficient."""

    name: str
    size_m: np.ndarray = array_field(3)
    center_m: np.ndarray = array_field(3)
    rgba: np.ndarray = array_field(4, default=(0.7, 0.7, 0.7, 1.0))
    friction: float = 1.0
    yaw_rad: float = 0.0
    mass_kg: float = 0.0  # 0: fixed


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at `position_m` that looks at `target_m`, in the frame of `body` ("" is the world).

    `up` is the direction that points up in the picture; `fovy_deg` the vertical field of view.
    """

    name: str
    position_m: np.ndarray = array_field(3)
    target_m: np.ndarray = array_field(3)
    up: np.ndarray = array_field(3, default=(0, 0, 1))
    fovy_deg: float = 45.0
    body: str = ""


@dataclass(frozen=True)
class Options:
    """What can be changed per start.

    arm, gripper: replace every follower's (tests of other hardware). arms: only these channels.
    friction, armature: factors on the profiles' dry friction and rotor inertia.
    latency_s: of the CAN adapter, each way. watchdog: what a motor does after its time-out, "limp" or "damping"
    (watchdog_damping, Nm s/rad). operator: task of the scripted operator, or "none".
    stamp_temperatures: temperature bytes carry the sample's time instead, see `control.sample_age_s`.
    camera_noise: grey levels (sigma) that the cameras' sensors add. seed: of lost frames and
    temperature noise. event_dir: folder that keeps the event log as
    `rig-<name>.events.jsonl`, one JSON object a line, also after the rig's end; none without.
    """

    arm: str | None = None
    gripper: str | None = None
    arms: tuple[str, ...] | None = None
    timestep_s: float = 0.001
    friction: float = 1.0
    armature: float = 1.0
    latency_s: float = 0.0
    watchdog: str = "limp"
    watchdog_damping: float = 1.0
    operator: str = "none"
    stamp_temperatures: bool = False
    camera_noise: float = 2.0
    seed: int = 0
    event_dir: str | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A whole scene. `places` are named points (x, y, z) m between which the operator carries the prop."""

    name: str
    arms: tuple[ArmPlacement, ...]
    props: tuple[Box, ...] = ()
    furniture: tuple[Box, ...] = ()
    cameras: tuple[Camera, ...] = ()
    places: dict[str, np.ndarray] = array_field(3, default=None)
    options: Options = Options()

    @property
    def channels(self) -> tuple[str, ...]:
        """CAN channel of each arm."""
        return tuple(arm.channel for arm in self.arms)


def load_scene(name: str | Path | None = None, options: Mapping[str, Any] | None = None) -> Scene:
    """The scene of that name (`SCENES`) or YAML path, with options replaced.

    Raises:
        ConfigError: unknown scene, option or value.
    """
    name = str(name or DEFAULT_SCENE)
    if name in SCENES:
        document = read_yaml(_DIRECTORY / f"{name}.yaml")
    elif name.endswith((".yaml", ".yml")):
        document = read_yaml(Path(name))
    else:
        raise ConfigError(f"unknown scene '{name}'; known: {', '.join(SCENES)}, or a path to a YAML file")
    options = dict(options or {})
    if isinstance(options.get("arms"), str):
        options["arms"] = options["arms"].split(",")
    document = merge(document, {"options": merge(document.get("options") or {}, options)})
    scene = parse(Scene, document, f"scene '{name}'")
    _check(scene)
    return _selected(scene)


def _check(scene: Scene) -> None:
    where, options = f"scene '{scene.name}'", scene.options
    if len(set(scene.channels)) != len(scene.channels) or not scene.arms:
        raise ConfigError(f"{where}: needs arms, each with a channel of its own, not {scene.channels}")
    for arm in scene.arms:
        if arm.role not in ROLES:
            raise ConfigError(f"{where}: role of {arm.channel} must be one of {ROLES}, not '{arm.role}'")
    for key, known in {"watchdog": WATCHDOGS, "operator": OPERATORS}.items():
        if getattr(options, key) not in known:
            raise ConfigError(f"{where}: option {key} must be one of {known}, not '{getattr(options, key)}'")
    positive = {"timestep_s": options.timestep_s, "armature": options.armature}
    not_negative = {"friction": options.friction, "latency_s": options.latency_s}
    wrong = [k for k, v in positive.items() if v <= 0] + [k for k, v in not_negative.items() if v < 0]
    if wrong:
        raise ConfigError(f"{where}: out of range: options {wrong}")
    unknown = set(options.arms or ()) - set(scene.channels)
    if unknown:
        raise ConfigError(f"{where}: option arms names unknown channels {sorted(unknown)}; known: {scene.channels}")


def _selected(scene: Scene) -> Scene:
    """The scene with the options arms, arm and gripper applied."""
    options = scene.options
    arms = []
    for row in scene.arms:
        if options.arms is not None and row.channel not in options.arms:
            continue
        if row.role == "follower":
            if options.arm is not None:
                row = replace(row, arm=options.arm, q_rad=None)
            if options.gripper is not None:
                row = replace(row, gripper=options.gripper, stops_rad=None, q_rad=None)
        arms.append(row)
    bodies = tuple(row.channel for row in arms)
    cameras = tuple(c for c in scene.cameras if not c.body or c.body.partition("/")[0] in bodies)
    return replace(scene, arms=tuple(arms), cameras=cameras)
