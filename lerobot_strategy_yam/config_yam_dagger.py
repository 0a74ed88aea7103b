"""Config of the rollout strategy `--strategy.type=yam_dagger`."""

import importlib.metadata
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lerobot.rollout.configs import RolloutStrategyConfig

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
from lerobot_robot_yam.face.registration import register_as

TAKES_PLUGINS = hasattr(RolloutStrategyConfig, "dataset_mode")
"""Whether the installed LeRobot accepts rollout strategies from plugins."""


SIDES = ("left", "right")
"""Arms in the column `intervention_arms`."""


@register_as(RolloutStrategyConfig, "yam_dagger")
@dataclass(kw_only=True)
class YamDaggerStrategyConfig(RolloutStrategyConfig):
    """Options of a rollout in which a person can take over any arm at any time; all frames are recorded."""

    # resources that LeRobot has to provide to the strategy
    dataset_mode: ClassVar[str] = "required"
    requires_teleop: ClassVar[bool] = True

    take_over_button: Literal["top", "bottom"] = option(
        "button of each handle that takes its arm over, and gives it back; a leader whose gate is not always has its "
        "gate for that",
        "bottom",
    )
    take_over: Literal["toggle", "hold"] = option(
        "toggle: a press takes the arm over, the next one gives it back; hold: the person drives while the button is "
        "down",
        "toggle",
    )
    rewind_button: Literal["top", "bottom"] | None = option(
        "button of any handle that ends the episode and sends the arms back along their way", "top"
    )
    rewind_s: float = option("how far back, s", 5.0)
    hand_back_s: float = option("in which an arm that is given back blends to the policy, s; joints only", 0.5)

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            RefusedConfigError: the installed LeRobot does not accept strategies from plugins, or a value is invalid.
        """
        if not TAKES_PLUGINS:
            raise RefusedConfigError(
                f"yam_dagger needs a LeRobot that takes rollout strategies from plugins, as its repository does since "
                f"September 2026; this is {importlib.metadata.version('lerobot')}. Install a newer one, or use "
                f"--strategy.type=dagger"
            )
        self.check()

    def check(self) -> None:
        """Check the values. Raises RefusedConfigError: a value is invalid."""
        if self.rewind_button == self.take_over_button:
            raise RefusedConfigError("yam_dagger: take_over_button and rewind_button are the same; give each its own")
        if self.take_over not in ("toggle", "hold"):
            raise RefusedConfigError(f"yam_dagger: take_over takes toggle or hold, not {self.take_over!r}")
        for name in ("rewind_s", "hand_back_s"):
            if not 0.0 <= getattr(self, name) <= 60.0:
                raise RefusedConfigError(f"yam_dagger: {name} takes a time within 0 … 60 s, not {getattr(self, name)}")

    def requires_streaming_encoding(self) -> bool:
        """Return True: the control loop adds the frames and must not wait for an encoder."""
        return True

    def extra_dataset_features(self) -> dict[str, dict[str, Any]]:
        """Return the columns that record whether a person has taken over an arm, and which one.

        The first is the column of LeRobot's own `dagger`. Of a robot with one arm, both values of the second column are
        those of this arm.
        """
        return {
            "intervention": {"dtype": "bool", "shape": (1,), "names": None},
            "intervention_arms": {"dtype": "bool", "shape": (len(SIDES),), "names": list(SIDES)},
        }
