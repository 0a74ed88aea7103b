"""Which keys a device speaks towards LeRobot: those of its joints, or those of its tools' poses."""

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol

import numpy as np

from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup


class ActionSpace(Protocol):
    """What `ArmGroup` offers for joints and `ee_space.EeSpace` for tools."""

    keys: list[str]

    def vector(self, action: Mapping[str, object]) -> np.ndarray:
        """Joints and grippers of a LeRobot action, in canonical order and SI units; raises YamError."""

    def action(self, vector: np.ndarray) -> dict[str, float]:
        """LeRobot's form of joints and grippers in canonical order and SI units."""

    def begin(self) -> None:
        """The next action has nothing to do with those before: something else has moved the arms."""


def make_action_space(
    kind: Literal["joint", "ee"], arms: ArmGroup, models: Sequence[tuple[ArmProfile, GripperProfile]]
) -> ActionSpace:
    """The keys that a config asks for.

    Args:
        kind: its `action_space`.
        arms: what is driven.
        models: for "ee", of each arm in canonical order: the arm and end effector whose tool is meant.

    Raises:
        ConfigError: no such kind, or an arm that has no tool pose.
    """
    if kind == "joint":
        return arms
    if kind == "ee":
        from lerobot_robot_yam.face.devices.ee_space import EeSpace  # mink takes a second to import

        return EeSpace(arms, models)
    raise ConfigError(f"{arms.device}: action_space must be joint or ee, not {kind!r}")
