"""Choice of the arms and the base that the page or the desktop window drives: of a config, or an arm's options."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig, check_together, passive_of
from lerobot_robot_yam.doctor.kit.targets import BaseTarget, calibration_root, from_config
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig

MARGIN_M = 0.02  # default collision margin between the parts of an arm, m, as in docs/workspace.md
_APART_M = 2.0  # distance between arms without a position in the config, m: out of each other's reach


@dataclass(frozen=True)
class DrivingPlan:
    """Arms and base to drive.

    Attributes:
        configs: configs of the arms.
        base: config of the mobile base, if there is one.
        poses: path of the file with saved poses.
        notes: deviations from the config, shown to the person who has to confirm them.
    """

    configs: tuple[ArmConfig, ...]
    poses: Path
    notes: tuple[str, ...] = ()
    base: BaseConfig | None = None

    @property
    def parts(self) -> tuple[ArmConfig | BaseConfig, ...]:
        """Configs of the arms and of the base."""
        return (*self.configs, *([] if self.base is None else [self.base]))


def plan_of_file(path: Path, rig: str | None) -> DrivingPlan:
    """Return the plan for the robot in a rig file or run config, or for the leaders if there is no robot.

    Raises:
        ConfigError: the file is unreadable, has no arm with motors and no base, or they cannot be used in one session.
    """
    plan = from_config(path, rig)
    base = next((target.config for target in plan.targets if isinstance(target, BaseTarget)), None)
    driven = plan.followers or (() if base else plan.arms)
    configs = [target.driven for target in driven if passive_of(target.config) is None]
    if not configs and base is None:
        raise ConfigError(f"{path} has no arm with motors, and no base")
    return plan_of(configs, path.with_name(f"{path.stem}.poses.json"), base)


def plan_of_arm(config: ArmConfig) -> DrivingPlan:
    """Return the plan for one arm. Raises ConfigError: a session cannot be created with this arm."""
    return plan_of([config], calibration_root() / "yam" / f"{config.channel}.poses.json")


def plan_of(configs: Sequence[ArmConfig], poses: Path, base: BaseConfig | None = None) -> DrivingPlan:
    """Return the plan for these arms and this base. Arms hold when energised.

    If no config sets a collision margin, all arms get `MARGIN_M`. The exception is arms without positions but with
    keep-out boxes: collision checking then stays off, with a note.

    Raises:
        ConfigError: the arms cannot be used together.
    """
    notes: list[str] = []
    if configs and not any(config.workspace.collision_margin_m is not None for config in configs):
        places = [tuple(config.workspace.base_position_m) for config in configs]
        unplaced = len(set(places)) < len(places)
        if unplaced and any(config.workspace.keep_out for config in configs):
            notes.append("NO COLLISION CHECKING: the config does not say where the arms stand (base_position_m).")
        else:
            notes.append(f"The config sets no collision margin. yam-view sets {MARGIN_M * 1000:.0f} mm.")
            if unplaced:
                notes.append("The config does not say where the arms stand: each arm is kept clear of itself only.")
            apart_m = _APART_M if unplaced else 0.0
            configs = [_guarded(config, apart_m * number) for number, config in enumerate(configs)]
    configs = [dataclasses.replace(config, start="hold") for config in configs]
    found = DrivingPlan(tuple(configs), poses, tuple(notes), base)
    check_together(found.parts)
    return found


def _guarded(config: ArmConfig, aside_m: float) -> ArmConfig:
    x, y, z = config.workspace.base_position_m
    workspace = dataclasses.replace(config.workspace, collision_margin_m=MARGIN_M, base_position_m=[x, y - aside_m, z])
    return dataclasses.replace(config, workspace=workspace)
