"""Options of a leader that concern its follower: coupling, gate, force feedback.

All values are plain, since the dataclass is sent to the control process as JSON. docs/teleoperation.md explains the
options.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from lerobot_robot_yam.arm.option import real
from lerobot_robot_yam.errors import ConfigError

GAIN_MOST = 0.5  # maximum force gain, as a fraction of the position gain: any person's hand can resist it
_SCALES = (0.05, 1.0)  # range of `fine_scale`
_THRESHOLD_MOST_RAD = 3.0
_SPEEDS_RAD_S = (0.05, 1.5)
_TIMES_S = (0.0, 10.0)

GateKind = Literal["auto", "button", "always"]
Button = Literal["top", "bottom"]


@dataclass(kw_only=True)
class LeadConfig:
    """Options of the leader in one leader-follower pair.

    Attributes:
        follower: CAN channel of the follower, on the leader's interface.
        arm, gripper: profiles of the follower.
        gate: what engages the pair: lifting the leader (auto), a button (button), or nothing: always engaged (always).
        together: whether both leaders of a robot share one gate.
        home_rad: (joints,) pose in which leader and follower wait; None: all zero.
        home_gripper: gripper opening of the follower in the pose `home_rad`, 0 closed … 1 open.
        gate_joints: joint numbers, from 1, whose distance from home opens the gate; empty: L2 norm of all joints.
        engage_threshold_rad, release_threshold_rad, release_s: the gate engages beyond the first threshold,
            and releases after `release_s` below the second.
        homing_speed_rad_s, idle_speed_rad_s: speed of the ramp home, and of a follower returning home in IDLE.
        approach_speed_rad_s, approach_s: speed and minimum duration of the follower's approach to the leader.
        gate_button, fine_button: handle buttons that engage and release, and that switch fine mode on and off.
        fine_scale: scale of the leader's motion in fine mode.
        bilateral: force feedback gain per joint, as a fraction of the leader's position gain; 0: none.
        mirror: whether the leader moves along with its follower while a policy drives the follower.
    """

    follower: str
    arm: str = "yam"
    gripper: str = "linear_4310"
    gate: GateKind = "always"
    together: bool = False
    home_rad: list[float] | None = None
    home_gripper: float = 0.0
    gate_joints: list[int] = field(default_factory=lambda: [2])
    engage_threshold_rad: float = 0.5
    release_threshold_rad: float = 0.3
    release_s: float = 0.5
    homing_speed_rad_s: float = 0.5
    idle_speed_rad_s: float = 0.7
    approach_speed_rad_s: float = 1.0
    approach_s: float = 0.5
    gate_button: Button | None = None
    fine_button: Button | None = None
    fine_scale: float = 0.3
    bilateral: list[float] | float = 0.0
    mirror: bool = False

    def check(self, name: str) -> None:
        """Check the values. Raises ConfigError: a value is invalid; the message names arm, option and valid values."""
        for key, (low, high), unit in (
            ("home_gripper", (0.0, 1.0), ""),
            ("engage_threshold_rad", (0.0, _THRESHOLD_MOST_RAD), " rad"),
            ("release_threshold_rad", (0.0, _THRESHOLD_MOST_RAD), " rad"),
            ("release_s", _TIMES_S, " s"),
            ("homing_speed_rad_s", _SPEEDS_RAD_S, " rad/s"),
            ("idle_speed_rad_s", _SPEEDS_RAD_S, " rad/s"),
            ("approach_speed_rad_s", _SPEEDS_RAD_S, " rad/s"),
            ("approach_s", _TIMES_S, " s"),
            ("fine_scale", _SCALES, ""),
        ):
            if not low <= real(getattr(self, key)) <= high:
                raise _refusal(name, self, key, f"a number within {low:g} … {high:g}{unit}")
        if not isinstance(self.follower, str) or not self.follower:
            raise _refusal(name, self, "follower", "the CAN channel of the follower, such as can_follower_l")
        if self.gate not in ("auto", "button", "always"):
            raise _refusal(name, self, "gate", "auto, button or always")
        if self.release_threshold_rad >= self.engage_threshold_rad:
            raise ConfigError(
                f"{name}: engage_threshold_rad ({self.engage_threshold_rad:g}) must exceed release_threshold_rad "
                f"({self.release_threshold_rad:g}): the gate would engage and release without end"
            )
        for key in ("gate_button", "fine_button"):
            if getattr(self, key) not in (None, "top", "bottom"):
                raise _refusal(name, self, key, "top or bottom")
        if self.gate_button is not None and self.gate_button == self.fine_button:
            raise ConfigError(f"{name}: gate_button and fine_button are both {self.fine_button!r}: one button each")
        if self.gate == "button" and self.gate_button is None:
            raise ConfigError(f"{name}: gate: button needs a gate_button, top or bottom")
        if self.gate != "button" and self.gate_button is not None:
            raise ConfigError(f"{name}: gate_button is for gate: button; the gate is {self.gate!r}")
        if self.mirror and self.gate == "auto":
            raise ConfigError(
                f"{name}: mirror moves the leader, and gate: auto would take that for a lift; set gate to always or "
                f"button"
            )
        gains = self.bilateral if isinstance(self.bilateral, list) else [self.bilateral]
        if not all(0.0 <= real(gain) <= GAIN_MOST for gain in gains):
            raise _refusal(name, self, "bilateral", f"gains within 0 … {GAIN_MOST:g}, one number or one per joint")
        if self.home_rad is not None and not all(math.isfinite(real(angle)) for angle in self.home_rad):
            raise _refusal(name, self, "home_rad", "angles in rad, one per joint")

    def check_joints(self, name: str, joints: int) -> None:
        """Check lists for an arm of `joints` joints. Raises ConfigError: a list does not fit; the message names it."""
        for key in ("home_rad", "bilateral"):
            value = getattr(self, key)
            if isinstance(value, list) and len(value) != joints:
                raise _refusal(name, self, key, f"{joints} numbers, one per joint")
        if not all(isinstance(joint, int) and 1 <= joint <= joints for joint in self.gate_joints):
            raise _refusal(name, self, "gate_joints", f"numbers of joints within 1 … {joints}")

    def check_handle(self, name: str, has_handle: bool) -> None:
        """Check the button options. Raises ConfigError: a button is set, but the arm has no teaching handle."""
        for key in ("gate_button", "fine_button"):
            if getattr(self, key) is not None and not has_handle:
                raise ConfigError(f"{name}: {key} is a button of the teaching handle, and this arm has none")


class LeadOptions:
    """Options of an arm that may have a follower."""

    @abstractmethod
    def lead_config(self) -> LeadConfig | None:
        """Create the options that concern the follower; None if the arm has no follower."""


def check_leads(configs: Sequence[LeadConfig]) -> None:
    """Check that the leaders of one robot have different followers, and the same options for a shared gate.

    Raises:
        ConfigError: two leaders have the same follower, or an option of a shared gate differs; the message names it.
    """
    followers = [config.follower for config in configs]
    if len(set(followers)) < len(followers):
        raise ConfigError(f"each leader needs a follower of its own, not both {followers[0]}")
    together = [config for config in configs if config.together]
    for key in ("gate", "engage_threshold_rad", "release_threshold_rad", "release_s"):
        if len({getattr(config, key) for config in together}) > 1:
            raise ConfigError(f"leaders whose gates move together need the same {key}; else set gate_together to false")


def _refusal(name: str, config: LeadConfig, key: str, takes: str) -> ConfigError:
    return ConfigError(f"{name}: {key} takes {takes}; got {getattr(config, key)!r}")
