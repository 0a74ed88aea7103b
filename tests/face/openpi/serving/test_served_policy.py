"""A checkpoint says of itself what a client can check, and knows observations by several names and forms."""

import numpy as np
import pytest
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import make_policy_config
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.relative_action_processor import RelativeActionsProcessorStep

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.openpi.served_policy import ObservationForm, ServedPolicy
from tests.support.tiny_policies import HEIGHT, WIDTH, N, observations, save_tiny

STATE, TOP, WRIST = "observation.state", "observation.images.top", "observation.images.wrist_left"


@pytest.fixture(scope="module")
def act(checkpoint):
    return ServedPolicy(str(checkpoint("act")), task="fold the towel")


@pytest.fixture
def seen():
    return observations("act", 1)[0]


def same(frame, other):
    return frame.keys() == other.keys() and all(np.array_equal(frame[key], other[key]) for key in frame)


def test_metadata(act):
    assert act.metadata == {
        "policy_type": "act",
        "action_dim": N,
        "state_dim": N,
        "image_keys": [TOP, WRIST],
        "endpoints": ["infer", "reset"],
        "image_resolution": [HEIGHT, WIDTH],
        "angle_unit": "rad",
        "action_horizon": 6,
        "stateful": False,
    }


def test_names_of_openpis_policies(act, seen):
    droid = {"observation/state": seen[STATE], "observation/images/top": seen[TOP], WRIST: seen[WRIST]}
    chw = {name.rpartition(".")[2]: seen[name].transpose(2, 0, 1) for name in (TOP, WRIST)}
    aloha = {"state": seen[STATE].astype(np.float64), "images": chw}
    for message in (droid, aloha, seen | {"observation.images.front": np.zeros(3), b"endpoint": 1, "more": [{}]}):
        frame, _ = act.question(message)
        assert same(frame, seen) and frame[STATE].dtype == np.float32
        assert all(value.flags.writeable and value.flags.c_contiguous for value in frame.values())


def test_the_prompt_is_the_clients_or_the_servers(act, seen):
    assert act.question(seen | {"prompt": "wave"})[1] == "wave"
    assert act.question(seen)[1] == act.question(seen | {"prompt": ""})[1] == "fold the towel"


def test_names_are_mapped_as_lerobot_rollout_maps_them(act, checkpoint, seen):
    names = {"observation.image": TOP, "observation.joints": STATE}
    policy = ServedPolicy(str(checkpoint("act")), rename_map=names)
    assert policy.metadata["image_keys"] == ["observation.image", WRIST]
    question = policy.question({"observation/image": seen[TOP], "joints": seen[STATE], WRIST: seen[WRIST]})
    assert np.array_equal(policy.actions(*question), act.actions(*act.question(seen)))


def test_other_image_sizes_for_policies_that_resize(checkpoint, seen):
    policy = ServedPolicy(str(checkpoint("act")), any_image_size=True)
    frame, _ = policy.question(seen | {TOP: np.zeros((20, 30, 3), dtype=np.uint8)})
    assert frame[TOP].shape == (20, 30, 3) and "image_resolution" not in policy.metadata


def test_images_that_a_policy_makes_itself_are_not_asked_for():
    image = PolicyFeature(type=FeatureType.VISUAL, shape=(3, 8, 8))
    config = make_policy_config("act", device="cpu", input_features={TOP: image, f"{TOP[:-3]}empty_camera_0": image})
    form = ObservationForm(config, {})
    assert (form.state, form.images) == (None, {TOP: (3, 8, 8)})


@pytest.mark.parametrize(
    "path, overrides, named",
    [
        ("/nowhere/to/be/found", (), "/nowhere/to/be/found cannot be loaded, which is no directory here, from the hub"),
        (None, ("--n_action_steps=5000",), "upper bound for the number of action steps"),
    ],
)
def test_a_checkpoint_that_cannot_be_loaded(checkpoint, path, overrides, named):
    with pytest.raises(ConfigError, match=named):
        ServedPolicy(path or str(checkpoint("act")), overrides)


def test_relative_actions_are_refused(tmp_path):
    """As by LeRobot's own engine of one action at a time."""
    save_tiny(tmp_path, "act")
    before = PolicyProcessorPipeline.from_pretrained(tmp_path, config_filename="policy_preprocessor.json")
    before.steps = [RelativeActionsProcessorStep(enabled=True), *before.steps]
    before.save_pretrained(tmp_path)
    with pytest.raises(ConfigError, match="relative actions"):
        ServedPolicy(str(tmp_path))
