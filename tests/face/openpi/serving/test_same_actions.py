"""What comes over the wire is, to the bit, what LeRobot's own engine makes of the same checkpoint."""

import contextlib

import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.policies.utils import prepare_observation_for_inference
from lerobot.rollout.inference.sync import SyncInferenceEngine

from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from tests.support.tiny_policies import HEIGHT, POLICIES, WIDTH, N, observations

LENGTHS = {"act": 6, "act, ensembling": 1, "vqbet": 5, "vqbet, history": 1, "diffusion": 4, "diffusion, history": 1}
STEPS = 13  # two chunks of ACT, and the beginning of a third
NAMES = [f"{side}_{joint}.pos" for side in ("left", "right") for joint in [*map(str, range(1, 7)), "gripper"]]


SHORT = ("act",)


@pytest.fixture(params=[pytest.param(name, marks=[] if name in SHORT else pytest.mark.long) for name in POLICIES])
def name(request):
    if "diffusion" in request.param:
        pytest.importorskip("diffusers", reason="LeRobot's diffusion policy needs diffusers")
    return request.param


def engine_of(policy, pipelines):
    before, after = pipelines
    features = {"action": {"dtype": "float32", "shape": (N,), "names": NAMES}}
    return SyncInferenceEngine(policy, before, after, features, NAMES, "fold the towel", "cpu", "bi_yam_follower")


def local_engine(path):
    """LeRobot's `sync`, as lerobot-rollout makes it of a checkpoint."""
    config = PreTrainedConfig.from_pretrained(path)
    policy = get_policy_class(config.type).from_pretrained(path, config=config).eval()
    overrides = {"device_processor": {"device": "cpu"}, "rename_observations_processor": {"rename_map": {}}}
    return engine_of(policy, make_pre_post_processors(config, path, preprocessor_overrides=overrides))


def episode(engine, seen):
    """(k, N): what an engine does in an episode; random policies throw the same dice each time."""
    engine.reset()
    torch.manual_seed(5)
    return torch.stack([engine.get_action(dict(observation)) for observation in seen]).numpy()


def test_chunks_are_those_of_the_policy(serve, checkpoint):
    """The same by `predict_action_chunk`, which LeRobot's `rtc` and its policy server ask."""
    engine = local_engine(checkpoint("act"))
    (seen,) = observations("act", 1)
    batch = prepare_observation_for_inference(dict(seen), torch.device("cpu"))
    with torch.inference_mode():
        chunk = engine._policy.predict_action_chunk(engine._preprocessor(batch))
        expected = engine._postprocessor(chunk)[0].numpy()
    got = serve("act", ["--n_action_steps=10"]).client().ask(seen)["actions"]
    assert got.shape == expected.shape == (10, N) and np.array_equal(got, expected)


def test_our_own_client_in_alohas_words(serve, checkpoint):
    seen = observations("act", 2)
    config = YamOpenpiConfig(
        host="127.0.0.1",
        port=serve("act").port,
        image_size=None,
        **{"state_key": "state", "image_group": "images", "image_layout": "chw"},
        image_keys={camera: camera for camera in POLICIES["act"][2]},
    )
    with contextlib.closing(get_policy_class("yam_openpi").from_pretrained(None, config=config)) as policy:
        expected = episode(local_engine(checkpoint("act")), seen)
        assert np.array_equal(episode(engine_of(policy, make_pre_post_processors(config)), seen), expected)


def test_our_own_client_gets_them_too(name, serve, checkpoint):
    """lerobot-rollout with `--policy.type=yam_openpi` does what it does with `--policy.path`, episode by episode."""
    seen = observations(name, STEPS)
    expected = episode(local_engine(checkpoint(name)), seen)
    assert np.ptp(expected, axis=0).min() > 0.0  # every value depends on something
    served = serve(name)
    assert served.policy.metadata["action_horizon"] == LENGTHS[name]
    config = YamOpenpiConfig(
        host="127.0.0.1",
        port=served.port,
        image_size=(HEIGHT, WIDTH),
        image_keys={camera: f"observation/images/{camera}" for camera in POLICIES[name][2]},
    )
    with contextlib.closing(get_policy_class("yam_openpi").from_pretrained(None, config=config)) as policy:
        engine = engine_of(policy, make_pre_post_processors(config))
        for _ in range(2):  # the second episode shows that the first is forgotten over there
            assert np.array_equal(episode(engine, seen), expected)
