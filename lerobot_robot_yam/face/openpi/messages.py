"""Messages of openpi's websocket protocol: encoding, the observation for the server, and checks of its replies.

All metadata and actions from the server are checked before they can reach an arm.

Messages are msgpack, with NumPy arrays and scalars as marked dictionaries: an array is
`{b"__ndarray__": True, b"data": bytes, b"dtype": "<f4", b"shape": [50, 14]}`, a scalar
`{b"__npgeneric__": True, b"data": value, b"dtype": "|b1"}`. Source: openpi-client 0.1.2, `msgpack_numpy.py`. The
package msgpack-numpy is no alternative: it uses other keys and falls back to pickle. openpi-client itself needs NumPy
1, LeRobot NumPy 2.
"""

import math
from typing import Any, get_args

import numpy as np
import torch
from lerobot.utils.constants import OBS_IMAGES, OBS_STATE
from PIL import Image

from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.openpi.configuration_openpi import ActionSpace, YamOpenpiConfig
from lerobot_robot_yam.system.own_commands import install_extra

try:
    import msgpack
except ImportError as error:
    raise ConfigError(f"openpi's protocol needs websockets and msgpack ({error}); {install_extra('openpi')}") from error

PROMPT_KEY = "prompt"
ENDPOINT_KEY, INFER, RESET = "endpoint", "infer", "reset"  # kinds of requests, from RoboArena's `policy_server.py`
ENDPOINTS_KEY = "endpoints"  # key in a greeting: kinds of requests that the server supports
IMAGE_KEYS = "image_keys"  # key in a greeting: names of the images that the server needs
STATEFUL_KEY = "stateful"  # key in a greeting: whether replies depend on earlier observations of the connection
RESET_DONE = "reset successful"  # RoboArena's reply to a reset, as text
_PREFIX = "observation."  # prefix of LeRobot's names of observed values
# NumPy's allowed kinds, and how a scalar of each kind arrives: numbers and text; no pointers, no code
_PLAIN_KINDS: dict[str, Any] = {"b": bool, "i": int, "u": int, "f": (float, int), "S": bytes, "U": str}
_MOST_ITEMS = 10_000  # maximum number of values in a message: an empty dictionary is 1 byte on the wire, 64 in memory
_ROW_BYTES = 4096  # maximum size of one row of an array without rows, bytes
# Maximum plausible angle, rad. No joint of these arms turns further than 3.2 rad, so larger numbers are degrees.
_LARGEST_RAD = 2.0 * math.pi


def observation_name(key: str) -> str:
    """Return LeRobot's name of the value under a key of a message.

    `observation.state` is also called `observation/state` (DROID, LIBERO) and `state` (ALOHA). `observation.images.top`
    in a dictionary `images` is called `top`, and its key is `images/top`.
    """
    name = key.replace("/", ".")
    return name if name.startswith(_PREFIX) else _PREFIX + name


def encode_message(message: Any) -> bytes:
    """Encode a message of dictionaries, lists, text, numbers and arrays. Raises TypeError: it has other values."""
    return msgpack.packb(message, default=_pack)


def decode_message(data: bytes) -> Any:
    """Decode a message, with read-only arrays, in memory of about the size of the data.

    Raises:
        ValueError: the data are not msgpack, an array is invalid, or there are too many values.
    """
    items = 0

    def count(values: Any) -> Any:
        nonlocal items
        items += 1 + len(values)
        if items > _MOST_ITEMS:
            raise ValueError(f"a message of openpi has at most {_MOST_ITEMS} values outside its arrays")
        return values

    most = {"max_array_len": _MOST_ITEMS, "max_map_len": _MOST_ITEMS}
    try:
        return msgpack.unpackb(data, object_hook=lambda values: _unpack(count(values)), list_hook=count, **most)
    except (KeyError, TypeError, msgpack.exceptions.UnpackException) as error:
        raise ValueError(f"not a message of openpi: {error!r}") from error


def _pack(value: Any) -> dict[bytes, Any]:
    if not isinstance(value, np.ndarray | np.generic):
        raise TypeError(f"{type(value).__name__} has no place in a message of openpi")
    _check_kind(value.dtype)
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}


def _unpack(value: dict[Any, Any]) -> Any:
    if b"__ndarray__" in value:
        data, dtype, shape = value[b"data"], _dtype(value), value[b"shape"]
        if math.prod(max(size, 1) for size in shape) * dtype.itemsize > max(len(data), _ROW_BYTES):
            raise ValueError(f"an array of {dtype} and shape {shape} has more than its {len(data)} bytes")
        return np.frombuffer(data, dtype).reshape(shape)
    if b"__npgeneric__" in value:
        data, dtype = value[b"data"], _dtype(value)
        if not isinstance(data, _PLAIN_KINDS[dtype.kind]):  # NumPy makes text of any length from a number
            raise TypeError(f"a scalar of {dtype} is no {type(data).__name__}")
        return dtype.type(data)
    return value


def _dtype(value: dict[Any, Any]) -> np.dtype:
    dtype = np.dtype(value[b"dtype"])
    _check_kind(dtype)
    return dtype


def _check_kind(dtype: np.dtype) -> None:
    if dtype.kind not in _PLAIN_KINDS:
        raise TypeError(f"arrays of {dtype} have no place in a message of openpi")


def server_observation(config: YamOpenpiConfig, batch: dict[str, Any], row: int) -> dict[str, Any]:
    """Build the message to the server for one row of a batch.

    Args:
        config: options with the names and formats that the server expects.
        batch: LeRobot's batch from the policy's preprocessor: `observation.state` (B, n), `observation.images.<camera>`
            (B, 3, H, W) from 0 to 1, `task`: B texts or one text.
        row: index of the row, 0 … B − 1.

    Returns:
        State float32 (n,), images uint8 (height, width, 3) or (3, height, width), and the prompt if there is one.

    Raises:
        ConfigError: the robot does not have a configured camera.
    """
    observation: dict[str, Any] = {config.state_key: batch[OBS_STATE][row].cpu().numpy().astype(np.float32)}
    images = {key: _image(config, batch, camera, row) for camera, key in config.image_keys.items()}
    if config.image_group is None:
        observation |= images
    else:
        observation[config.image_group] = images
    task = batch.get("task") or ""
    prompt = config.prompt or (task if isinstance(task, str) else task[row])
    if prompt:  # without a prompt, the server uses its default
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
    if tensor.is_floating_point():  # rounding restores the camera's exact values
        tensor = (tensor * 255.0).round().clamp(0, 255).to(torch.uint8)
    image = tensor.permute(1, 2, 0).cpu().numpy()
    if config.image_size is not None:
        image = resize_with_pad(np.ascontiguousarray(image), *config.image_size)
    return np.ascontiguousarray(image.transpose(2, 0, 1) if config.image_layout == "chw" else image)


def resize_with_pad(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return a black image of this size, with the largest fitting copy of the given image in its centre.

    Resizing is bilinear, to a size rounded down to whole pixels. The result therefore equals, in each pixel, that of
    `openpi_client.image_tools.resize_with_pad` (0.1.2), which openpi uses in training, too.

    Args:
        image: (H, W, 3), uint8.
        height, width: size of the result, pixels.

    Returns:
        (height, width, 3), uint8.
    """
    if image.shape[:2] == (height, width):
        return image
    shrink = max(image.shape[1] / width, image.shape[0] / height)
    inner_height, inner_width = int(image.shape[0] / shrink), int(image.shape[1] / shrink)
    inner = Image.fromarray(image).resize((inner_width, inner_height), resample=Image.Resampling.BILINEAR)
    top, left = (height - inner_height) // 2, (width - inner_width) // 2
    padded = np.zeros((height, width, 3), dtype=np.uint8)
    padded[top : top + inner_height, left : left + inner_width] = np.asarray(inner)
    return padded


def check_metadata(config: YamOpenpiConfig, metadata: dict[str, Any]) -> None:
    """Compare the server's metadata with the config. Keys that are missing in the metadata are not checked.

    `angle_unit`, `action_dim` and `action_horizon` come from a user's own `policy_metadata` in openpi's TrainConfig,
    `action_space` and `image_resolution` (height, width) from RoboArena, `image_keys` from `yam-policy-server`.

    Raises:
        ConfigError: metadata and config contradict each other.
    """
    space = metadata.get("action_space", config.action_space)
    if space not in get_args(ActionSpace):
        raise ConfigError(
            f"the {config.server} says that its action_space is {space!r}; these arms can be driven by "
            f"{' or '.join(get_args(ActionSpace))}"
        )
    for key in ("angle_unit", "action_space", "action_dim"):
        value = getattr(config, key)
        if value is not None and metadata.get(key, value) != value:
            raise ConfigError(
                f"the {config.server} says that its {key} is {metadata[key]!r}, --policy.{key} is {value!r}; they have "
                f"to agree, and the robot with them"
            )
    resolution = metadata.get("image_resolution")
    if resolution is not None and config.image_size is not None and list(resolution) != list(config.image_size):
        size = ",".join(str(pixels) for pixels in resolution)
        raise ConfigError(f"the {config.server} wants images of {resolution}; set '--policy.image_size=[{size}]'")
    group = "" if config.image_group is None else f"{config.image_group}/"
    sent = {observation_name(f"{group}{key}") for key in config.image_keys.values()}
    missing = [key for key in metadata.get(IMAGE_KEYS, []) if observation_name(key) not in sent]
    if missing:
        raise ConfigError(
            f"the {config.server} has to see {', '.join(missing)}, which --policy.image_keys does not send; name a "
            f"camera of the robot for each, as in '--policy.image_keys={{top: {missing[0]}}}'"
        )
    horizon = metadata.get("action_horizon")
    if horizon is not None and config.n_action_steps is not None and config.n_action_steps > horizon:
        raise ConfigError(f"--policy.n_action_steps is {config.n_action_steps}, the {config.server} plans {horizon}")


def check_state(config: YamOpenpiConfig, state: np.ndarray) -> None:
    """Check that positions (n,) can be in the server's unit.

    Raises:
        ConfigError: the robot uses degrees, the server radians.
    """
    if config.angle_unit == "rad" and np.abs(state).max(initial=0.0) > _LARGEST_RAD:
        raise ConfigError(
            f"observation.state contains {np.abs(state).max():.1f}, which is no angle in rad; unset "
            f"--robot.use_degrees, or set --policy.angle_unit=deg if the {config.server} was trained on degrees"
        )


def action_chunk(config: YamOpenpiConfig, answer: dict[str, Any], width: int) -> np.ndarray:
    """Return the actions of a reply, float32 (steps, width).

    Args:
        config: options with the key of the actions, and the required number of actions.
        answer: reply of the server.
        width: number of values in one action.

    Raises:
        ActionError: the actions are missing, have the wrong type or shape, are not finite, or not angles in radians.
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
    with np.errstate(over="ignore"):  # an overflow becomes infinite, which is refused below
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
