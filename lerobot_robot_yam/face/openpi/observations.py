"""LeRobot's observation in the words of an openpi server."""

from typing import Any

import numpy as np
import torch
from lerobot.utils.constants import OBS_IMAGES, OBS_STATE

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from lerobot_robot_yam.face.openpi.padded_images import resize_with_pad

PROMPT_KEY = "prompt"


def server_observation(config: YamOpenpiConfig, batch: dict[str, Any], row: int) -> dict[str, Any]:
    """What the server is sent for one row of a batch.

    Args:
        config: names and forms that the server expects.
        batch: LeRobot's, from the policy's preprocessor: `observation.state` (B, n), `observation.images.<camera>`
            (B, 3, H, W) from 0 to 1, `task`: B texts or one.
        row: which of the B.

    Returns:
        State float32 (n,), images uint8 (height, width, 3) or (3, height, width), prompt where there is one.

    Raises:
        ConfigError: the robot has no such camera.
    """
    observation: dict[str, Any] = {config.state_key: batch[OBS_STATE][row].cpu().numpy().astype(np.float32)}
    images = {key: _image(config, batch, camera, row) for camera, key in config.image_keys.items()}
    if config.image_group is None:
        observation |= images
    else:
        observation[config.image_group] = images
    task = batch.get("task") or ""
    prompt = config.prompt or (task if isinstance(task, str) else task[row])
    if prompt:  # without one, the server takes the default prompt that it was started with
        observation[PROMPT_KEY] = prompt
    return observation


def _image(config: YamOpenpiConfig, batch: dict[str, Any], camera: str, row: int) -> np.ndarray:
    name = f"{OBS_IMAGES}.{camera}"
    if name not in batch or batch[name].shape[-3] != 3:
        cameras = [key.removeprefix(f"{OBS_IMAGES}.") for key in batch if key.startswith(f"{OBS_IMAGES}.")]
        raise ConfigError(
            f"--policy.image_keys names the camera {camera!r}, of which there is no colour image; the robot has: "
            f"{', '.join(cameras) or 'no cameras'}"
        )
    tensor = batch[name][row]
    if tensor.is_floating_point():  # rounded, it is exactly what the camera gave
        tensor = (tensor * 255.0).round().clamp(0, 255).to(torch.uint8)
    image = tensor.permute(1, 2, 0).cpu().numpy()
    if config.image_size is not None:
        image = resize_with_pad(np.ascontiguousarray(image), *config.image_size)
    return np.ascontiguousarray(image.transpose(2, 0, 1) if config.image_layout == "chw" else image)
