"""LeRobot config of a policy that runs on an openpi server (`--policy.type=yam_openpi`). See docs/openpi.md.

LeRobot finds the three modules of a policy by their names: `configuration_*`, `modeling_*` and `processor_*`.
"""

import os
from dataclasses import dataclass, field
from typing import Literal

from lerobot.configs.policies import PreTrainedConfig

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as

ActionSpace = Literal["joint_position", "cartesian_position"]


@register_as(PreTrainedConfig, "yam_openpi")
@dataclass
class YamOpenpiConfig(PreTrainedConfig):
    """Options of a policy server: address, format of requests, meaning of replies. The server computes the actions.

    Attributes:
        host: name or address of the server; or a whole URL (`wss://…`), which makes `port` unused.
        port: TCP port of the server.
        api_key_env: environment variable with the server's API key, if the server requires one. The key itself appears
            in no config and no log.
        prompt: text sent to the server; None sends LeRobot's task (`--task`), or no prompt if the task is empty.
        image_keys: camera → key of its image in the server's requests: `{top: observation/image}`.
        image_group: name of the dictionary in which the server expects the images (ALOHA's policies: `images`).
        image_layout: order of an image's axes; ALOHA's policies need `chw`.
        image_size: height and width in pixels, produced by `resize_with_pad`; None sends the camera's size.
        state_key: the server's key for `observation.state`.
        action_key: key of the action chunk in the server's replies.
        n_action_steps: number of actions executed from each chunk before the next request; None executes all.
        action_dim: number of values in one action; None: as in the environment or in `observation.state`.
        angle_unit: unit of the server's angles. The robot has to use the same unit: `deg` needs
            `--robot.use_degrees=true`.
        action_space: action space of the server, in RoboArena's words; compared with the server's metadata. The robot
            has to use the same space: `cartesian_position` needs `--robot.action_space=ee`.
        connect_timeout_s: timeout for the server to start, and for its greeting.
        first_response_timeout_s: timeout of the first reply after a start of the server, when JAX compiles the model.
        response_timeout_s: timeout of any other reply. The arms hold after 0.5 s without an action.
    """

    device: str | None = "cpu"  # device of the tensors for LeRobot; the server chooses the model's device
    push_to_hub: bool = False

    host: str = "localhost"
    port: int = 8000
    api_key_env: str | None = None
    prompt: str | None = None
    image_keys: dict[str, str] = field(default_factory=dict)
    image_group: str | None = None
    image_layout: Literal["hwc", "chw"] = "hwc"
    image_size: tuple[int, int] | None = (224, 224)
    state_key: str = "observation/state"
    action_key: str = "actions"
    n_action_steps: int | None = None
    action_dim: int | None = None
    angle_unit: Literal["rad", "deg"] = "rad"
    action_space: ActionSpace = "joint_position"
    connect_timeout_s: float = 10.0
    first_response_timeout_s: float = 120.0
    response_timeout_s: float = 10.0

    @property
    def url(self) -> str:
        return self.host if self.host.startswith(("ws://", "wss://")) else f"ws://{self.host}:{self.port}"

    @property
    def server(self) -> str:
        return f"openpi server {self.url.partition('://')[2].rpartition('@')[2]}"

    def api_key(self) -> str | None:
        """Return the API key from the environment. Raises ConfigError: the variable is not set."""
        if self.api_key_env is None:
            return None
        key = os.environ.get(self.api_key_env)
        if not key:
            raise ConfigError(f"--policy.api_key_env names {self.api_key_env}, which is not set in the environment")
        return key

    def validate_features(self) -> None:
        """Check the fields. LeRobot's policies call this when they are created.

        Raises:
            ConfigError: a value is invalid.
        """
        for name in ("connect_timeout_s", "first_response_timeout_s", "response_timeout_s"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"--policy.{name} is {getattr(self, name)}; it has to be more than 0 s")
        for name in ("n_action_steps", "action_dim"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ConfigError(f"--policy.{name} is {value}; it has to be at least 1")
        if self.image_size is not None and min(self.image_size) < 1:
            raise ConfigError(f"--policy.image_size is {self.image_size}; both have to be at least 1 pixel")
        keys = [self.state_key, *self.image_keys.values()]
        if len(set(keys)) < len(keys):
            raise ConfigError(f"--policy.image_keys and --policy.state_key use a key twice: {keys}")

    @property
    def observation_delta_indices(self) -> None:
        return None

    action_delta_indices = reward_delta_indices = observation_delta_indices

    def get_optimizer_preset(self) -> None:
        raise ConfigError("a yam_openpi policy is trained on its server; lerobot-train has nothing to train")

    get_scheduler_preset = get_optimizer_preset
