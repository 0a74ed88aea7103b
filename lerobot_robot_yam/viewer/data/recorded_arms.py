"""Arms of a data set: each arm's columns in states and actions, and the figures that show all arms at one frame."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import viser

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.doctor.kit.targets import Plan
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, OpenedDataset, RecordedEpisode
from lerobot_robot_yam.face.datasets.layout import value_names
from lerobot_robot_yam.face.devices.feature_names import JOINT, motor_names
from lerobot_robot_yam.session.trajectory import Trajectory, columns_of
from lerobot_robot_yam.viewer.figure import Figure
from lerobot_robot_yam.viewer.live.placement import row_of

ARM, GRIPPER, NO_GRIPPER = "yam", "linear_4310", "no_gripper"


@dataclass(frozen=True)
class RecordedArm:
    """Arm of a data set.

    Attributes:
        prefix: prefix of the arm's value names, such as `left_`; empty for a single arm.
        hardware: profiles of the arm.
        columns: feature (`action`, `observation.state`) → columns of the joints, then of a motorised gripper. Features
            that lack any of these columns are not listed.
        unit: rad per unit of a recorded joint value.
    """

    prefix: str
    hardware: ResolvedArm
    columns: Mapping[str, list[int]]
    unit: float

    def positions(self, episode: RecordedEpisode, feature: str) -> np.ndarray | None:
        """Return positions (n, motors), rad, gripper 0 closed … 1 open, or None if the feature lacks them."""
        if feature not in self.columns or feature not in episode.rows:
            return None
        found = np.array(episode.rows[feature][:, self.columns[feature]], dtype=float)
        found[:, : self.hardware.joints] *= self.unit
        return found

    def trajectory(self, episode: RecordedEpisode, fps: float, speed: float) -> Trajectory:
        """Return the motion given by this arm's recorded actions, played `speed` times as fast as recorded.

        Raises:
            ConfigError: the actions are not joint positions.
            ActionError: the actions are not finite, or too few.
        """
        positions = self.positions(episode, ACTION)
        if positions is None:
            raise ConfigError(f"the actions are no positions of the joints and gripper of {self.hardware.name}")
        times = np.arange(len(positions)) / (fps * speed)
        source = f"episode {episode.number}, {self.prefix.rstrip('_') or 'arm'}"
        return Trajectory(times, positions, columns_of([self.hardware]), source)


def motion_of(
    arms: Sequence[RecordedArm], prefixes: Sequence[str], episode: RecordedEpisode, fps: float, speed: float
) -> Trajectory:
    """Return the motion given by the recorded actions of all arms, with columns in the order of `prefixes`.

    Raises:
        ActionError: the episode has other arms than `prefixes`, or its actions are not finite or too few.
        ConfigError: the episode's actions are not joint positions.
    """
    ways = {arm.prefix: arm.trajectory(episode, fps, speed) for arm in arms}
    if ways.keys() != set(prefixes):
        raise ActionError(
            f"the recording is of the arms {_list(ways)}, and the run config has {_list(prefixes)}; nothing moves"
        )
    chosen = [ways[prefix] for prefix in prefixes]
    positions = np.concatenate([way.positions for way in chosen], axis=1)
    columns = tuple(column for way in chosen for column in way.columns)
    return Trajectory(chosen[0].times_s, positions, columns, f"episode {episode.number}")


def _list(prefixes: Iterable[str]) -> str:
    return ", ".join(prefix.rstrip("_") or "one arm" for prefix in prefixes)


def recorded_arms(data: OpenedDataset, known: Mapping[str, ArmConfig], arm: str, gripper: str) -> list[RecordedArm]:
    """Return the arms for which the actions or states contain joints with our names.

    Args:
        known: prefix → config of the arm, from a run config.
        arm, gripper: profiles of arms not in `known`. Such an arm gets no gripper unless its opening is recorded.

    Raises:
        ConfigError: a profile is unknown, or its joint count differs from the recording's.
    """
    named = {feature: list(value_names(data.features.get(feature, {}))) for feature in (STATE, ACTION)}
    matches = [match for names in named.values() for match in map(JOINT.fullmatch, names) if match]
    return [
        _arm(prefix, known.get(prefix), named, data.unit, arm, gripper)
        for prefix in sorted({match[1] or "" for match in matches})
    ]


def followers(plan: Plan) -> dict[str, ArmConfig]:
    """Return value prefix (as in data sets) → config, for the followers of a run config."""
    configs = [target.driven for target in plan.followers]
    return dict(zip(("left_", "right_") if len(configs) > 1 else ("",), configs, strict=False))


def _arm(
    prefix: str, config: ArmConfig | None, named: Mapping[str, list[str]], unit: float, arm: str, gripper: str
) -> RecordedArm:
    recorded = {name for names in named.values() for name in names}
    if config is None:
        grips = f"{prefix}gripper.pos" in recorded
        config = ArmConfig(channel="-", name=f"{prefix}arm", arm=arm, gripper=gripper if grips else NO_GRIPPER)
    joints, motor = load_arm(config.arm).joint_count, load_gripper(config.gripper).motor
    there = sum(1 for name in recorded if (match := JOINT.fullmatch(name)) and (match[1] or "") == prefix)
    if there != joints:
        raise ConfigError(
            f"{prefix or 'the arm'} has {there} joints in this data set, and {config.arm} has {joints}: name the right "
            "profile with --arm, or the run config with --config_path"
        )
    wanted = [f"{name}.pos" for name in motor_names(prefix, joints, motor is not None)]
    columns = {
        feature: [names.index(name) for name in wanted] for feature, names in named.items() if {*wanted} <= {*names}
    }
    return RecordedArm(prefix, ResolvedArm(config), columns, unit)


class RecordedFigures:
    """Figures of all arms of a data set. They show the measured pose, or the commanded pose if no state was recorded.

    Args:
        scene: the server's scene.
        root: name of the figures' parent frame.
        arms: arms of the data set.
        ghost: whether to draw the arms in one pale colour.
    """

    def __init__(self, scene: viser.SceneApi, root: str, arms: Sequence[RecordedArm], ghost: bool = False):
        self._arms = arms
        self._figures = [Figure(scene, f"{root}/{arm.prefix or 'arm'}", arm.hardware, ghost) for arm in arms]
        for figure, place in zip(self._figures, row_of(arm.hardware for arm in arms), strict=True):
            figure.stand(*place)
        self._ways: list[np.ndarray | None] = [None] * len(arms)

    def open(self, episode: RecordedEpisode) -> None:
        """Select the episode to show."""
        self._ways = []
        for arm in self._arms:
            measured = arm.positions(episode, STATE)
            self._ways.append(arm.positions(episode, ACTION) if measured is None else measured)

    def pose(self, frame: int) -> None:
        """Show a frame, clamped to the end of the episode."""
        for arm, figure, way in zip(self._arms, self._figures, self._ways, strict=True):
            if way is not None and len(way):
                row, joints = way[min(frame, len(way) - 1)], arm.hardware.joints
                figure.pose(row[:joints], float(row[joints]) if len(row) > joints else None)

    @property
    def visible(self) -> bool:
        """Whether the figures are shown."""
        return any(figure.visible for figure in self._figures)

    @visible.setter
    def visible(self, shown: bool) -> None:
        for figure in self._figures:
            figure.visible = shown
