"""What an openpi server says of itself, and its actions: checked before anything of it reaches an arm."""

import math
from typing import Any, get_args

import numpy as np

from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.openpi.configuration_openpi import ActionSpace, YamOpenpiConfig

# No joint of these arms turns further than 3.2 rad either way, so a larger number is an angle in degrees.
_LARGEST_RAD = 2.0 * math.pi


def check_metadata(config: YamOpenpiConfig, metadata: dict[str, Any]) -> None:
    """Compare what the server says of itself with the config. Keys that it does not mention are not checked.

    `angle_unit`, `action_dim` and `action_horizon` are for one's own `policy_metadata` in openpi's TrainConfig;
    `action_space` and `image_resolution` (height, width) are RoboArena's.

    Raises:
        ConfigError: they contradict each other.
    """
    ours: dict[str, Any] = {"angle_unit": config.angle_unit, "action_space": config.action_space}
    if config.action_dim is not None:
        ours["action_dim"] = config.action_dim
    space = metadata.get("action_space", config.action_space)
    if space not in get_args(ActionSpace):
        raise ConfigError(
            f"the {config.server} says that its action_space is {space!r}; these arms can be driven by "
            f"{' or '.join(get_args(ActionSpace))}"
        )
    for key, value in ours.items():
        if key in metadata and metadata[key] != value:
            raise ConfigError(
                f"the {config.server} says that its {key} is {metadata[key]!r}, --policy.{key} is {value!r}; they have "
                f"to agree, and the robot with them"
            )
    resolution = metadata.get("image_resolution")
    if resolution is not None and config.image_size is not None and list(resolution) != list(config.image_size):
        size = ",".join(str(pixels) for pixels in resolution)
        raise ConfigError(f"the {config.server} wants images of {resolution}; set '--policy.image_size=[{size}]'")
    horizon = metadata.get("action_horizon")
    if horizon is not None and config.n_action_steps is not None and config.n_action_steps > horizon:
        raise ConfigError(f"--policy.n_action_steps is {config.n_action_steps}, the {config.server} plans {horizon}")


def check_state(config: YamOpenpiConfig, state: np.ndarray) -> None:
    """Refuse to send positions (n,) that are not in the server's unit, as far as that can be seen.

    Raises:
        ConfigError: the robot speaks degrees, the server radians.
    """
    if config.angle_unit == "rad" and np.abs(state).max(initial=0.0) > _LARGEST_RAD:
        raise ConfigError(
            f"observation.state contains {np.abs(state).max():.1f}, which is no angle in rad; unset "
            f"--robot.use_degrees, or set --policy.angle_unit=deg if the {config.server} was trained on degrees"
        )


def action_chunk(config: YamOpenpiConfig, answer: dict[str, Any], width: int) -> np.ndarray:
    """The actions of an answer, float32 (steps, width).

    Args:
        config: which key they have, and how many of them are needed.
        answer: the server's.
        width: values of one action.

    Raises:
        ActionError: they are missing, of a wrong type or shape, not finite, or no angles in rad.
    """
    actions = answer.get(config.action_key)
    if not isinstance(actions, np.ndarray):
        raise ActionError(
            f"the {config.server} answered without an array {config.action_key!r}, only with "
            f"{', '.join(map(str, answer)) or 'nothing'}; --policy.action_key says which key its actions have"
        )
    whose = f"the actions of the {config.server}"
    if actions.dtype.kind != "f":
        raise ActionError(f"{whose} are {actions.dtype}, not floating-point numbers; check its policy's outputs")
    if actions.ndim != 2 or len(actions) == 0:
        raise ActionError(f"{whose} have the shape {actions.shape}, not (steps, {width}); check its policy's outputs")
    if actions.shape[1] != width:
        raise ActionError(
            f"{whose} have {actions.shape[1]} values, this robot's {width}; is it a policy for another number of "
            "arms, or for arms with other joints? Where the state is wider than an action, --policy.action_dim says "
            "what to expect"
        )
    if len(actions) < (config.n_action_steps or 1):
        raise ActionError(
            f"{whose} are {len(actions)} steps, fewer than --policy.n_action_steps={config.n_action_steps}"
        )
    with np.errstate(over="ignore"):  # too large for a float is infinite, and said below
        actions = actions.astype(np.float32)
    if not np.isfinite(actions).all():
        step, value = np.argwhere(~np.isfinite(actions))[0]
        raise ActionError(f"{whose} are not finite: value {value} of step {step} is {actions[step, value]}")
    if config.angle_unit == "rad" and np.abs(actions).max() > _LARGEST_RAD:
        raise ActionError(
            f"{whose} contain {np.abs(actions).max():.1f}, which is no angle in rad; was it trained on degrees? Then "
            f"set --policy.angle_unit=deg and --robot.use_degrees=true"
        )
    return actions
