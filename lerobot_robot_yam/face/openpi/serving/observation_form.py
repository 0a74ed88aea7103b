"""What a checkpoint has to see; and what a client sends, checked against it and brought into LeRobot's form."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.configs.policies import PreTrainedConfig
from lerobot.utils.constants import OBS_IMAGES, OBS_STATE

from lerobot_robot_yam.errors import ObservationError
from lerobot_robot_yam.face.openpi.wire_format import observation_name

_STAND_IN = f"{OBS_IMAGES}.empty_camera"  # images that pi0 and SmolVLA make themselves (`empty_cameras`)


@dataclass(frozen=True)
class ObservationForm:
    """Names and shapes of an observation.

    Attributes:
        state: name and number of values of the state; None: the policy sees none.
        images: (channels, height, width) of each image, by its name.
        any_image_size: images of other heights and widths are taken, too.
    """

    state: tuple[str, int] | None
    images: Mapping[str, tuple[int, ...]]
    any_image_size: bool = False

    @classmethod
    def of_policy(
        cls, config: PreTrainedConfig, rename_map: Mapping[str, str], any_image_size: bool = False
    ) -> "ObservationForm":
        """The form that a policy needs.

        Args:
            config: the policy's.
            rename_map: LeRobot's: names that clients use, and what they are for the policy.
            any_image_size: see the attribute.
        """
        sent_as = {theirs: ours for ours, theirs in rename_map.items()}
        state = config.robot_state_feature
        images = {
            sent_as.get(name, name): tuple(feature.shape)
            for name, feature in config.image_features.items()
            if not name.startswith(_STAND_IN)
        }
        n_state = None if state is None else (sent_as.get(OBS_STATE, OBS_STATE), state.shape[0])
        return cls(n_state, images, any_image_size)

    def frame(self, message: Mapping[Any, Any]) -> dict[str, np.ndarray]:
        """The part of a message that the policy sees, as `lerobot-rollout` would hand it on.

        Args:
            message: arrays by their keys (`observation_name`); a dictionary in it groups some of them.

        Returns:
            State (n,) float32; images (height, width, channels) uint8. All are copies.

        Raises:
            ObservationError: something is missing, of a wrong type or shape, or not finite.
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
        if image.ndim == 3 and image.shape[0] == channels != image.shape[2]:  # as openpi's policies for ALOHA want it
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
    with np.errstate(over="ignore"):  # too large for a float is infinite, and said below
        state = state.astype(np.float32)
    if not np.isfinite(state).all():
        raise ObservationError(f"{name} is not finite: {state.tolist()}")
    return state


def _array(name: str, value: Any) -> np.ndarray:
    if not isinstance(value, np.ndarray):
        raise ObservationError(f"{name} is a {type(value).__name__}; it has to be an array")
    return value
