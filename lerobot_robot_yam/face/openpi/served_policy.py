"""LeRobot checkpoint that returns a chunk for an observation: the actions that `lerobot-rollout` would execute.

LeRobot's engine `sync` (`lerobot/rollout/inference/sync.py`) calls `select_action` once per step. A policy that uses
only the current observation ignores all observations of a chunk except the first. Therefore this module computes the
whole chunk from one observation, action by action, each through the postprocessor. A policy that remembers earlier
observations, or blends its chunks, needs the observation of each step: such a policy returns one action at a time.
"""

import contextlib
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs import parser
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.policies.utils import prepare_observation_for_inference
from lerobot.processor.relative_action_processor import RelativeActionsProcessorStep
from lerobot.utils.constants import OBS_IMAGES, OBS_STATE
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_robot_yam.errors import ConfigError, ObservationError
from lerobot_robot_yam.face.datasets.recording import of_checkpoint, unit_of
from lerobot_robot_yam.face.devices.feature_names import space_of
from lerobot_robot_yam.face.openpi.messages import (
    ENDPOINTS_KEY,
    IMAGE_KEYS,
    INFER,
    PROMPT_KEY,
    RESET,
    STATEFUL_KEY,
    observation_name,
)

logger = logging.getLogger(__name__)

_STAND_IN = f"{OBS_IMAGES}.empty_camera"  # prefix of images that pi0 and SmolVLA create themselves (`empty_cameras`)
_UNITS = {"radians": "rad", "degrees": "deg"}  # unit of a recording → its word in the metadata
_SPACES = {"joint": "joint_position", "ee": "cartesian_position"}  # action space → RoboArena's word


class ObservationForm:
    """Names and shapes of the observation that a policy needs.

    Args:
        config: config of the policy.
        rename_map: LeRobot's mapping from the client's name to the policy's name.
        any_image_size: whether images of other heights and widths are accepted.

    Attributes:
        state: (name, number of values) of the state; None for a policy without a state.
        images: name of an image → (channels, height, width).
    """

    def __init__(self, config: PreTrainedConfig, rename_map: Mapping[str, str], any_image_size: bool = False):
        sent_as = {theirs: ours for ours, theirs in rename_map.items()}
        state = config.robot_state_feature
        self.state = None if state is None else (sent_as.get(OBS_STATE, OBS_STATE), state.shape[0])
        self.images = {
            sent_as.get(name, name): tuple(feature.shape)
            for name, feature in config.image_features.items()
            if not name.startswith(_STAND_IN)
        }
        self.any_image_size = any_image_size

    def frame(self, message: Mapping[Any, Any]) -> dict[str, np.ndarray]:
        """Return the part of a message that the policy uses, in the format of `lerobot-rollout`.

        Args:
            message: key (see `observation_name`) → array, or → dictionary that groups some arrays.

        Returns:
            State (n,) float32; images (height, width, channels) uint8. All are copies.

        Raises:
            ObservationError: a value is missing, has the wrong type or shape, or is not finite.
        """
        sent: dict[str, Any] = {}
        for key, value in message.items():
            inner = {f"{key}/{name}": item for name, item in value.items()} if isinstance(value, dict) else {key: value}
            sent |= {observation_name(str(name)): item for name, item in inner.items()}
        wanted = [*self.images, *([] if self.state is None else [self.state[0]])]
        missing = [name for name in wanted if name not in sent]
        if missing:
            raise ObservationError(
                f"the observation has no {', '.join(missing)}; this policy has to see {', '.join(wanted)}, and "
                f"was sent {', '.join(sent) or 'nothing'}"
            )
        frame = {name: self._image(name, _array(name, sent[name])) for name in self.images}
        if self.state is not None:
            frame[self.state[0]] = _state(*self.state, sent[self.state[0]])
        return frame

    def _image(self, name: str, image: np.ndarray) -> np.ndarray:
        channels, *size = self.images[name]
        # axis order of openpi's policies for ALOHA
        if image.ndim == 3 and image.shape[0] == channels != image.shape[2]:
            image = image.transpose(1, 2, 0)
        if image.ndim != 3 or image.shape[2] != channels or image.dtype != np.uint8 or image.size == 0:
            raise ObservationError(
                f"{name} is {image.dtype} of the shape {image.shape}; it has to be uint8, (height, width, {channels})"
            )
        if list(image.shape[:2]) != size and not self.any_image_size:
            raise ObservationError(
                f"{name} has {image.shape[0]} x {image.shape[1]} pixels (height x width), and the policy was trained "
                f"with {size[0]} x {size[1]}; send that size (--policy.image_size of a yam_openpi policy), or start "
                "the server with --any-image-size if this policy resizes images itself"
            )
        return np.array(image)


def _state(name: str, count: int, value: Any) -> np.ndarray:
    state = _array(name, value)
    if state.dtype.kind != "f" or state.shape != (count,):
        raise ObservationError(
            f"{name} is {state.dtype} of the shape {state.shape}; this policy has to see {count} floating-point "
            "numbers. Is the robot the one that it was trained on?"
        )
    with np.errstate(over="ignore"):  # an overflow becomes infinite, which is refused below
        state = state.astype(np.float32)
    if not np.isfinite(state).all():
        raise ObservationError(f"{name} is not finite: {state.tolist()}")
    return state


def _array(name: str, value: Any) -> np.ndarray:
    if not isinstance(value, np.ndarray):
        raise ObservationError(f"{name} is a {type(value).__name__}; it has to be an array")
    return value


class ServedPolicy:
    """Policy with its processors, as loaded by `lerobot-rollout --policy.path=…`. For one thread at a time.

    Args:
        path: directory of the checkpoint, or its repository on the hub.
        overrides: LeRobot's options for the policy's config, such as `--n_action_steps=10`.
        rename_map: LeRobot's mapping from the client's name to the policy's name.
        task: task for clients that send no prompt.
        any_image_size: whether images of any size are accepted, for policies that resize images themselves.

    Attributes:
        metadata: greeting for clients.
        n_actions: number of actions in a reply.

    Raises:
        ConfigError: the checkpoint cannot be loaded, or cannot be served.
    """

    def __init__(
        self,
        path: str,
        overrides: Sequence[str] = (),
        rename_map: Mapping[str, str] | None = None,
        task: str = "",
        any_image_size: bool = False,
    ):
        rename_map = dict(rename_map or {})
        config, self._policy, self._before, self._after = _loaded(path, list(overrides), rename_map)
        if config.action_feature is None:
            raise ConfigError(f"the checkpoint {path} has no actions; it is no policy for a robot")
        if any(isinstance(step, RelativeActionsProcessorStep) and step.enabled for step in self._before.steps):
            raise ConfigError(f"the checkpoint {path} has relative actions, which are not served, as LeRobot's sync")
        self._device, self._task = torch.device(config.device), task
        self._autocast = self._device.type == "cuda" and config.use_amp
        self.form = ObservationForm(config, rename_map, any_image_size)
        stateful = _remembers(config)
        self.n_actions = 1 if stateful else _chunk_length(config)
        revision = config.pretrained_revision
        self.metadata = _metadata(path, revision, config, self.form) | {
            "action_horizon": self.n_actions,
            STATEFUL_KEY: stateful,
        }

    def question(self, message: Mapping[Any, Any]) -> tuple[dict[str, np.ndarray], str]:
        """Return observation and task of a client's message, without running the policy.

        Raises:
            ObservationError: the message lacks a value that the policy needs (`ObservationForm`).
        """
        prompt = message.get(PROMPT_KEY)
        return self.form.frame(message), prompt if isinstance(prompt, str) and prompt else self._task

    def actions(self, frame: Mapping[str, np.ndarray], task: str) -> np.ndarray:
        """Compute the next actions, (n_actions, n) float32, in the units of the training data.

        frame, task: observation and task as returned by `question`.
        """
        autocast = torch.autocast(self._device.type) if self._autocast else contextlib.nullcontext()
        with torch.inference_mode(), autocast:
            batch = self._before(prepare_observation_for_inference(dict(frame), self._device, task))
            steps = [self._after(self._policy.select_action(dict(batch))) for _ in range(self.n_actions)]
        return torch.cat(steps).float().cpu().numpy()

    def reset(self) -> None:
        for part in (self._policy, self._before, self._after):
            part.reset()


def _loaded(path: str, overrides: list[str], rename_map: dict[str, str]) -> tuple[PreTrainedConfig, Any, Any, Any]:
    """Load config, policy, preprocessor and postprocessor of a checkpoint, as LeRobot's `rollout/context.py` does."""
    register_third_party_plugins()
    revision = parser.parse_arg("pretrained_revision", overrides)
    try:
        config = PreTrainedConfig.from_pretrained(path, revision=revision, cli_overrides=overrides)
        if config.use_peft:
            raise ConfigError("it is an adapter (PEFT); merge it into its base model first")
        config.pretrained_path = path
        if hasattr(config, "compile_model") and parser.parse_arg("compile_model", overrides) is None:
            config.compile_model = False  # even if the value was True in training
        policy = get_policy_class(config.type).from_pretrained(path, config=config, revision=revision)
        before, after = make_pre_post_processors(
            config,
            path,
            revision,
            preprocessor_overrides={
                "device_processor": {"device": config.device},
                "rename_observations_processor": {"rename_map": rename_map},
            },
        )
    except Exception as error:  # each type of policy raises its own errors
        where = "" if Path(path).is_dir() else ", which is no directory here, from the hub"
        raise ConfigError(f"the checkpoint {path} cannot be loaded{where}: {_cause(error)}") from error
    policy.to(config.device).eval()
    logger.info("loaded %s, a policy of the type %s, on %s", path, config.type, config.device)
    return config, policy, before, after


def _cause(error: BaseException) -> BaseException:
    """Return the first cause of an error: LeRobot's parser hides a config's messages about its values."""
    return error if error.__cause__ is None else _cause(error.__cause__)


def _remembers(config: PreTrainedConfig) -> bool:
    """Return whether actions depend on earlier observations, by a history or by ACT's temporal ensembling."""
    return config.n_obs_steps > 1 or getattr(config, "temporal_ensemble_coeff", None) is not None


def _chunk_length(config: PreTrainedConfig) -> int:
    """Return the number of actions that `select_action` returns before it runs the model again."""
    for name in ("n_action_steps", "action_chunk_size"):  # the second is VQ-BeT's name
        if hasattr(config, name):
            return getattr(config, name)
    return 1


def _metadata(path: str, revision: str | None, config: PreTrainedConfig, form: ObservationForm) -> dict[str, Any]:
    """Return the metadata that a client can compare with its settings (`check_metadata`), as far as they are known."""
    learnt = of_checkpoint(path, revision)
    n = config.action_feature.shape[0]
    metadata: dict[str, Any] = {
        "policy_type": config.type,
        "action_dim": n,
        "state_dim": form.state and form.state[1],
        IMAGE_KEYS: list(form.images),
        ENDPOINTS_KEY: [INFER, RESET],
    }
    sizes = {shape[1:] for shape in form.images.values()}
    if len(sizes) == 1 and not form.any_image_size:
        metadata["image_resolution"] = list(sizes.pop())
    unit = unit_of(learnt, np.ones(n, dtype=bool))  # includes grippers, whose 0 to 1 is too small to affect the result
    space = space_of(learnt.names)
    if space in _SPACES:
        metadata["action_space"] = _SPACES[space]
    if unit is not None and space != "ee":
        metadata["angle_unit"] = _UNITS[unit]
    return metadata
