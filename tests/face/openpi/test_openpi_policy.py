"""A LeRobot policy whose actions come from an openpi server: what it is sent, and chunks handed out one by one."""

import draccus
import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import PushtEnv
from lerobot.policies import make_policy, make_pre_post_processors
from lerobot.policies.rtc import RTCConfig

from lerobot_robot_yam.errors import ConfigError, PolicyServerError
from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from lerobot_robot_yam.face.openpi.messages import resize_with_pad
from tests.face.openpi.conftest import batch_of
from tests.support.openpi_server import answering, zeros


def test_it_is_a_policy_of_lerobot(made):
    _, policy = made()
    assert policy.config.type == policy.name == "yam_openpi" and isinstance(policy.config, YamOpenpiConfig)
    assert not policy.training and list(policy.parameters()) == []
    _, postprocessor = make_pre_post_processors(policy.config)
    action = torch.rand(1, 14)
    assert torch.equal(postprocessor(action), action)


def test_config_survives_a_directory(made, tmp_path):
    _, policy = made(image_keys={"top": "observation/image"}, n_action_steps=3)
    policy.save_pretrained(tmp_path)
    again = PreTrainedConfig.from_pretrained(tmp_path)
    assert (again.image_keys, again.n_action_steps, again.port) == (policy.config.image_keys, 3, policy.config.port)


def test_config_from_the_command_line():
    arguments = ["--image_size=[120,160]", "--image_keys={top: images/top, wrist: w}", "--image_layout=chw"]
    config = draccus.parse(YamOpenpiConfig, args=arguments)
    assert config.image_size == (120, 160) and config.image_keys == {"top": "images/top", "wrist": "w"}
    assert draccus.parse(YamOpenpiConfig, args=["--image_size=null"]).image_size is None


@pytest.mark.parametrize("steps", [None, 2])
def test_chunks_are_handed_out_one_by_one_and_forgotten_at_a_reset(made, steps):
    server, policy = made(n_action_steps=steps)
    batch, _ = batch_of(policy)
    actions = [policy.select_action(batch) for _ in range(5)]
    assert all(action.shape == (1, 14) and action.dtype == torch.float32 for action in actions)
    policy.reset()
    actions.append(policy.select_action(batch))
    given = [round(float(a[0, 5]) * 1000) for a in actions]
    assert given == ([0, 1, 2, 3, 100, 200] if steps is None else [0, 1, 100, 101, 200, 300])
    assert len(server.observations) == given[-1] // 100 + 1 and server.connections == 1


def test_observation_is_sent_as_the_server_wants_it(made):
    keys = {"top": "observation/image", "wrist": "observation/wrist_image"}
    server, policy = made(image_keys=keys, image_size=None)
    batch, images = batch_of(policy, cameras=("top", "wrist", "unused"), task="lift the cube")
    policy.select_action(batch)
    (sent,) = server.observations
    assert sorted(sent) == ["observation/image", "observation/state", "observation/wrist_image", "prompt"]
    assert sent["prompt"] == "lift the cube"
    assert sent["observation/state"].dtype == np.float32 and sent["observation/state"].shape == (14,)
    for camera, key in keys.items():  # to the bit what the camera gave, through LeRobot's floats
        assert np.array_equal(sent[key], images[f"observation.images.{camera}"])


def test_observation_in_alohas_words(made):
    server, policy = made(
        answering(zeros()), image_keys={"top": "cam_high"}, image_group="images", image_layout="chw", state_key="state"
    )
    batch, images = batch_of(policy, task="")
    policy.select_action(batch)
    (sent,) = server.observations
    assert sorted(sent) == ["images", "state"]  # no task, no prompt: the server has a default one
    expected = resize_with_pad(images["observation.images.top"], 224, 224)
    assert np.array_equal(sent["images"]["cam_high"], expected.transpose(2, 0, 1))


def test_prompt_of_the_config_wins(made):
    server, policy = made(prompt="fold the towel")
    policy.select_action(batch_of(policy)[0])
    assert server.observations[0]["prompt"] == "fold the towel"


def test_rows_of_a_batch_are_questions_of_their_own(made):
    server, policy = made()
    batch, _ = batch_of(policy, rows=3, task="lift")
    batch["task"] = ["a", "b", "c"]
    assert policy.select_action(batch).shape == (3, 14)
    assert [sent["prompt"] for sent in server.observations] == ["a", "b", "c"]


def test_lerobot_eval_makes_it_for_an_environment(made):
    _, config = made(answering(zeros(width=2)), connect=False)
    policy = make_policy(cfg=config, env_cfg=PushtEnv())
    try:
        batch, _ = batch_of(policy, width=5)
        assert policy.select_action(batch).shape == (1, 2)  # as many values as the environment's action has
    finally:
        policy.close()


def test_velocities_are_no_angles(made):
    _, policy = made(answering(zeros()), action_dim=14)
    state = {"observation.state": np.array([0.1] * 14 + [9.0] * 14, dtype=np.float32)}
    assert policy.select_action(batch_of(policy, **state)[0]).shape == (1, 14)


def test_degrees_where_both_speak_them(made):
    degrees = {"actions": np.full((4, 14), 30.0)}
    _, policy = made(answering(degrees), metadata={"angle_unit": "deg"}, angle_unit="deg")
    assert float(policy.select_action(batch_of(policy)[0])[0, 0]) == 30.0


def test_metadata_that_fit(made):
    metadata = {
        "reset_pose": [0, -1.5, 1.5, 0, 0, 0],
        "angle_unit": "rad",
        "image_resolution": [180, 320],
        "action_horizon": 50,
    }
    made(metadata=metadata, image_size=(180, 320), n_action_steps=50)


def test_it_is_not_trained_here(made):
    _, policy = made()
    for call in (policy.config.get_optimizer_preset, policy.get_optim_params, lambda: policy.forward({})):
        with pytest.raises(ConfigError, match="train"):
            call()


# real-time chunking


def test_without_rtc_chunks_are_whole(made):
    _, policy = made(n_action_steps=2)
    assert policy.supports_rtc() and policy.predict_action_chunk(batch_of(policy)[0]).shape == (1, 4, 14)


@pytest.mark.parametrize("enabled", [True, False])
def test_rtc_passes_softly_from_chunk_to_chunk(made, enabled):
    _, policy = made(answering({"actions": np.full((20, 14), 1.0)}))
    policy.config.rtc_config = RTCConfig(enabled=enabled, execution_horizon=10)
    policy.init_rtc_processor()
    running = torch.zeros(10, 14)
    running[:8] = 0.2  # the engine pads with zeros, which are no actions
    (chunk,) = policy.predict_action_chunk(batch_of(policy)[0], inference_delay=3, prev_chunk_left_over=running)
    values = chunk[:, 0]
    assert chunk.shape == (20, 14) and torch.equal(chunk, values[:, None].expand(20, 14))
    if enabled:
        assert torch.allclose(values[:3], torch.tensor(0.2)) and torch.allclose(values[8:], torch.tensor(1.0))
        steps = values.diff()
        assert (steps >= -1e-6).all() and steps.max() < 0.2
    else:  # LeRobot appends the chunk to the running one then
        assert torch.equal(values, torch.ones(20))


def test_rtc_waits_for_the_first_observation_of_an_episode(made):
    """LeRobot's engine goes on with what it saw before the reset."""
    _, policy = made(answering({"actions": np.full((6, 14), 1.0)}))
    policy.config.rtc_config = RTCConfig(execution_horizon=10)
    policy.init_rtc_processor()
    batch = batch_of(policy)[0]
    policy.reset()
    policy.predict_action_chunk(batch)  # nothing was seen before
    policy.reset()
    with pytest.raises(PolicyServerError, match="a new episode has begun"):
        policy.predict_action_chunk(batch)
    assert policy.predict_action_chunk(batch).shape == (1, 6, 14)

    ask = policy._ask

    def ask_late(*arguments):
        policy.reset()
        return ask(*arguments)

    policy._ask = ask_late
    with pytest.raises(PolicyServerError, match="an episode that is over"):
        policy.predict_action_chunk(batch)


def test_rtc_with_nothing_left_of_the_running_chunk(made):
    _, policy = made(answering({"actions": np.full((6, 14), 1.0)}))
    policy.config.rtc_config = RTCConfig(execution_horizon=10)
    policy.init_rtc_processor()
    for left in (torch.zeros(10, 14), None):
        chunk = policy.predict_action_chunk(batch_of(policy)[0], inference_delay=3, prev_chunk_left_over=left)
        assert torch.equal(chunk, torch.ones(1, 6, 14))
