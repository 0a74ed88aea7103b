"""Common part of followers and leaders: one or two arms as a LeRobot device."""

from collections.abc import Collection, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from lerobot.utils.decorators import check_if_not_connected

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup
from lerobot_robot_yam.face.devices.pair_check import Models
from lerobot_robot_yam.face.lerobot_command.config_refusal import arm_config
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.session.uncopyable import Uncopied

if TYPE_CHECKING:
    from lerobot_robot_yam.face.devices.ee_space import EeSpace


class ArmDevice(Uncopied):
    """Mixin for a LeRobot `Robot` or `Teleoperator` with YAM arms."""

    name: str
    id: str | None
    calibration_dir: Path
    _arms: ArmGroup
    _models: Models
    _space: "ArmGroup | EeSpace"
    """Converter between actions and joints: the group itself for joints, `EeSpace` for end-effector poses."""

    def _make_arms(
        self,
        role: str,
        arms: Mapping[str, ArmConfig],
        use_degrees: bool,
        isolation: Isolation,
        handles: Collection[str] | None = None,
        base: BaseConfig | None = None,
    ) -> ArmGroup:
        """Create the `ArmGroup` of arms and their base. Messages name an unnamed arm by prefix and `role`."""
        configs = {prefix: arm_config(arm, f"{prefix}{role}") for prefix, arm in arms.items()}
        for prefix, arm in configs.items():
            if arm.calibration_path is None:  # default: in a subdirectory, whose files LeRobot never reads
                ident = f"{prefix}{self.id}" if self.id else arm.channel
                arm.calibration_path = str(self.calibration_dir / "yam" / f"{ident}_gripper.json")
        return ArmGroup(self.name, configs, use_degrees, isolation, handles, base)

    def _speak(self, kind: Literal["joint", "ee"], models: Models) -> None:
        """Choose the action space: joint angles, or end-effector poses computed with `models`.

        Raises:
            ConfigError: the action space is unknown, or an arm has no end-effector pose.
        """
        self._models = models
        if kind == "joint":
            self._space = self._arms
        elif kind == "ee":
            from lerobot_robot_yam.face.devices.ee_space import EeSpace  # mink takes a second to import

            self._space = EeSpace(self._arms, models)
        else:
            raise ConfigError(f"{self.name}: action_space must be joint or ee, not {kind!r}")

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features `joint_1.pos` … (or `ee_x.pos` …), `gripper.pos`; for two arms with `left_`, then `right_`."""
        return dict.fromkeys(self._space.keys, float)

    @property
    def is_connected(self) -> bool:
        """Whether the arms are connected. Cameras do not count: a dead camera must not prevent landing."""
        return self._arms.connected

    @property
    def is_calibrated(self) -> bool:
        """Whether the stops of all gripper motors are known without a search; handles have no stops."""
        return self._arms.calibrated

    @check_if_not_connected
    def calibrate(self) -> None:
        """Search for the stops of gripper motors and store them. There must be no object between the fingers.

        Raises:
            YamError: the search of a gripper failed.
        """
        self._arms.calibrate()

    def configure(self) -> None:
        """Do nothing: the control loop has checked and set up the motors."""

    @check_if_not_connected
    def rearm(self) -> None:
        """Re-enable arms after a fault (docs/faults.md). Inspect the arms first.

        Afterwards followers hold their pose and leaders float.

        Raises:
            YamError: an arm is still in fault, or has to be connected again.
        """
        self._arms.rearm()
