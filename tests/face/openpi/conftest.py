"""A server and a policy on it."""

import numpy as np
import pytest
import torch
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.policies.utils import prepare_observation_for_inference

from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from tests.support.openpi_server import OpenpiServer, counting


@pytest.fixture
def made():
    """Makes a server and a policy on it; both are gone at the end."""
    closing = []

    def make(answer=counting, metadata=None, api_key=None, connect=True, **fields):
        server = OpenpiServer(answer, metadata, api_key)
        closing.append(server.__enter__())
        config = YamOpenpiConfig(**{"host": "127.0.0.1", "port": server.port, "response_timeout_s": 30.0} | fields)
        if not connect:
            return server, config
        policy = get_policy_class("yam_openpi").from_pretrained(None, config=config, revision=None)
        closing.append(policy)
        return server, policy

    yield make
    for thing in reversed(closing):
        thing.close() if hasattr(thing, "close") else thing.__exit__()


def batch_of(policy, cameras=("top",), width=14, task="lift", rows=1, **values):
    """What LeRobot's engine hands a policy."""
    rng = np.random.default_rng(1)
    frame = {"observation.state": np.linspace(0.0, 0.7, width, dtype=np.float32)}
    frame |= {f"observation.images.{c}": rng.integers(0, 255, (120, 160, 3), dtype=np.uint8) for c in cameras}
    frame |= values
    images = {key: value for key, value in frame.items() if "images" in key}
    batch = prepare_observation_for_inference(dict(frame), torch.device("cpu"), task, "bi_yam_follower")
    batch = make_pre_post_processors(policy.config)[0](batch)
    return {k: v.repeat(rows, *[1] * (v.ndim - 1)) if torch.is_tensor(v) else v for k, v in batch.items()}, images
