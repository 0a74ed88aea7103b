"""Workspace of an arm: pose of its base in the rig, floor, keep-out boxes and collision margin.

The dataclasses have plain values and import no heavy module: LeRobot parses them as part of `ArmConfig`, and they are
sent as JSON. `collision_guard` enforces the limits. The rig frame is any frame common to the arms of one robot, z up.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.option import from_plain, option, real
from lerobot_robot_yam.errors import ConfigError

_MOST_MARGIN_M = 0.3  # maximum collision margin, m: more than half a forearm must be a mistake in units


@dataclass(kw_only=True)
class KeepOut:
    """Box in the rig frame that no part of the arm may enter.

    Attributes:
        name: name for messages ("camera mast").
        center_m: centre (3), m.
        size_m: full extents (3), m.
        yaw_rad: rotation about the vertical, rad.
    """

    name: str = "box"
    center_m: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    size_m: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    yaw_rad: float = 0.0


@dataclass(kw_only=True)
class WorkspaceConfig:
    """Limits of one arm in space. By default nothing is limited."""

    base_position_m: list[float] = option(
        "where the arm's base stands in the rig frame, m", factory=lambda: [0.0, 0.0, 0.0]
    )
    base_yaw_rad: float = option("turn of the base about the vertical, rad", 0.0)
    floor_z_m: float | None = option(
        "no moving part goes below this height of the rig frame, m; by default there is no floor", None
    )
    keep_out: list[KeepOut] = option(
        "boxes that no moving part enters; floor and boxes are the limits themselves, without a margin", factory=list
    )
    collision_margin_m: float | None = option(
        "how near the arm's parts may come to each other and to the robot's other arm, m; by default not checked,"
        " unless the other arm asks for it",
        None,
    )

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> "WorkspaceConfig":
        """Create a config from plain values, as from `asdict` or JSON. Raises ConfigError: a key is unknown."""
        boxes = [from_plain(KeepOut, box, "workspace.keep_out") for box in _boxes(values)]
        return from_plain(cls, {**values, "keep_out": boxes}, "workspace")

    @property
    def limits_anything(self) -> bool:
        """Whether any limit is set."""
        return self.floor_z_m is not None or bool(self.keep_out) or self.collision_margin_m is not None

    def check(self, arm: str) -> None:
        """Check the values. Raises ConfigError: a value is invalid; the message names `arm` and the value."""
        _numbers(arm, "base_position_m", self.base_position_m, 3)
        _numbers(arm, "base_yaw_rad", [self.base_yaw_rad], 1)
        if self.floor_z_m is not None:
            _numbers(arm, "floor_z_m", [self.floor_z_m], 1)
        if self.collision_margin_m is not None:
            (margin,) = _numbers(arm, "collision_margin_m", [self.collision_margin_m], 1)
            if not 0.0 <= margin <= _MOST_MARGIN_M:
                raise ConfigError(
                    f"{arm}: workspace.collision_margin_m is in metres, 0 … {_MOST_MARGIN_M}; got {margin}"
                )
        for box in self.keep_out:
            where = f"keep_out '{box.name}'"
            _numbers(arm, f"{where} center_m", box.center_m, 3)
            _numbers(arm, f"{where} yaw_rad", [box.yaw_rad], 1)
            if min(_numbers(arm, f"{where} size_m", box.size_m, 3)) <= 0.0:
                raise ConfigError(f"{arm}: workspace.{where} needs three extents above zero, not {box.size_m}")
        names = [box.name for box in self.keep_out]
        if len(set(names)) != len(names):
            raise ConfigError(f"{arm}: workspace.keep_out boxes need different names, not {names}")


def _boxes(values: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    boxes = values.get("keep_out") or []
    if not isinstance(boxes, Sequence) or not all(isinstance(box, Mapping) for box in boxes):
        raise ConfigError(f"workspace.keep_out is a list of boxes {{name, center_m, size_m, yaw_rad}}, not {boxes!r}")
    return boxes


def _numbers(arm: str, what: str, values: Sequence[Any], count: int) -> list[float]:
    """Convert `values` to `count` finite floats. Raises ConfigError: wrong count, or a value is not finite."""
    numbers = [real(value) for value in values] if isinstance(values, Sequence | np.ndarray) else []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise ConfigError(f"{arm}: workspace.{what} takes {count} finite number(s), not {values!r}")
    return numbers
