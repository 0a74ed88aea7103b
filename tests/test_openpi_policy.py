"""The policy of an openpi server: bytes as openpi's own, chunks one by one, and errors instead of motions."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import draccus
import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import PushtEnv
from lerobot.policies import get_policy_class, make_policy, make_pre_post_processors
from lerobot.policies.rtc import RTCConfig
from lerobot.policies.utils import prepare_observation_for_inference
from PIL import Image

from lerobot_robot_yam.errors import ActionError, ConfigError, PolicyServerError, YamError
from lerobot_robot_yam.openpi import wire
from lerobot_robot_yam.openpi.configuration_openpi import YamOpenpiConfig
from lerobot_robot_yam.openpi.images import resize_with_pad
from tests.openpi_server import TRACEBACK, OpenpiServer

# Made with msgpack_numpy.packb of the published openpi-client 0.1.2 (under NumPy 2, which its metadata forbid).
GOLDEN_QUESTION = {
    "observation/image": np.arange(6, dtype=np.uint8).reshape(1, 2, 3),
    "observation/state": np.array([0.0, 0.5, -1.0], dtype=np.float32),
    "prompt": "lift the cube",
}
GOLDEN_ANSWER = {
    "actions": np.array([[0.1, -0.2], [0.3, 1.0]]),
    "state": np.array([1, 2], dtype=np.int32),
    "policy_timing": {"infer_ms": 12.5},
    "ok": np.bool_(True),
}
GOLDEN_METADATA = {"reset_pose": [0, -1.5, 1.5, 0, 0, 0]}
GOLDEN = [
    (
        GOLDEN_QUESTION,
        "83b16f62736572766174696f6e2f696d61676584c40b5f5f6e6461727261795f5fc3c40464617461c406000102030405c4056474797065"
        "a37c7531c405736861706593010203b16f62736572766174696f6e2f737461746584c40b5f5f6e6461727261795f5fc3c40464617461c4"
        "0c000000000000003f000080bfc4056474797065a33c6634c40573686170659103a670726f6d7074ad6c696674207468652063756265",
    ),
    (
        GOLDEN_ANSWER,
        "84a7616374696f6e7384c40b5f5f6e6461727261795f5fc3c40464617461c4209a9999999999b93f9a9999999999c9bf333333333333d3"
        "3f000000000000f03fc4056474797065a33c6638c4057368617065920202a5737461746584c40b5f5f6e6461727261795f5fc3c4046461"
        "7461c4080100000002000000c4056474797065a33c6934c40573686170659102ad706f6c6963795f74696d696e6781a8696e6665725f6d"
        "73cb4029000000000000a26f6b83c40d5f5f6e7067656e657269635f5fc3c40464617461c3c4056474797065a37c6231",
    ),
    (GOLDEN_METADATA, "81aa72657365745f706f73659600cbbff8000000000000cb3ff8000000000000000000"),
]


def assert_same(one, other):
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype and np.array_equal(one, other)
    else:
        assert one == other


@pytest.mark.parametrize("message, golden", GOLDEN, ids=["question", "answer", "metadata"])
def test_bytes_are_those_of_openpi(message, golden):
    assert wire.encode(message).hex() == golden
    assert_same(wire.decode(bytes.fromhex(golden)), message)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        bytes.fromhex(GOLDEN[0][1])[:-3],
        wire.encode({"a": np.zeros(3)}).replace(b"<f8", b"|O8"),  # pointers, as openpi's own reader would make them
        wire.encode({"a": np.zeros(3)}).replace(b"<f8", b"<zz"),
        wire.encode({"a": np.zeros(3)}).replace(b"dtype", b"ditty"),
        wire.encode({"a": np.zeros(3)}).replace(b"<f8", b"<f4"),  # twice as many numbers as the shape says
    ],
)
def test_other_bytes_are_refused(data):
    with pytest.raises(ValueError):
        wire.decode(data)


@pytest.mark.parametrize("value", [object(), np.array([object()]), np.array([1j]), {"a": torch.zeros(2)}])
def test_nothing_else_is_sent(value):
    with pytest.raises(TypeError, match="no place in a message"):
        wire.encode({"a": value})


def test_images_are_padded_as_in_training():
    image = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    padded = resize_with_pad(image, 224, 224)
    inner = np.asarray(Image.fromarray(image).resize((224, 168), Image.Resampling.BILINEAR))
    assert np.array_equal(padded[28:196], inner) and not padded[:28].any() and not padded[196:].any()
    tall = resize_with_pad(image.transpose(1, 0, 2).copy(), 100, 200)
    assert tall.shape == (100, 200, 3) and tall[:, 62:137].any(axis=(1, 2)).all() and not tall[:, :62].any()
    assert resize_with_pad(image, 240, 320) is image


# the policy on a server


def zeros(steps=4, width=14, dtype=np.float64):
    return {"actions": np.zeros((steps, width), dtype=dtype)}


def counting(observation, number):
    """A chunk whose actions say which one of which chunk they are, in thousandths."""
    width = len(observation["observation/state"])
    return {"actions": np.tile(((number * 100 + np.arange(4)) / 1000.0)[:, None], (1, width))}


def answering(answer):
    return lambda observation, number: answer


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


def test_chunks_are_handed_out_one_by_one(made):
    server, policy = made()
    batch, _ = batch_of(policy)
    actions = [policy.select_action(batch) for _ in range(9)]
    assert all(action.shape == (1, 14) and action.dtype == torch.float32 for action in actions)
    assert [round(float(a[0, 5]) * 1000) for a in actions] == [0, 1, 2, 3, 100, 101, 102, 103, 200]
    assert len(server.observations) == 3 and server.connections == 1


def test_only_the_first_steps_of_a_chunk(made):
    _, policy = made(n_action_steps=2)
    batch, _ = batch_of(policy)
    assert [round(float(policy.select_action(batch)[0, 0]) * 1000) for _ in range(5)] == [0, 1, 100, 101, 200]


def test_reset_forgets_the_chunk(made):
    _, policy = made()
    batch, _ = batch_of(policy)
    policy.select_action(batch)
    policy.reset()
    assert round(float(policy.select_action(batch)[0, 0]) * 1000) == 100


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


@pytest.mark.parametrize(
    "answer, named",
    [
        ({"actions": np.full((4, 14), np.nan)}, "value 0 of step 0 is nan"),
        ({"actions": np.full((4, 14), 1e300)}, "is inf"),
        (zeros(width=7), "have 7 values, this robot's 14"),
        (zeros(width=32), "have 32 values, this robot's 14"),
        (zeros(dtype=np.int64), "int64"),
        ({"actions": np.zeros(14)}, r"shape \(14,\)"),
        (zeros(steps=0), r"shape \(0, 14\)"),
        (zeros(steps=2), "are 2 steps, fewer"),
        ({"actions": [[0.0] * 14]}, "without an array 'actions', only with actions"),
        ({"action": np.zeros((4, 14))}, "only with action; --policy.action_key"),
        ({"actions": np.full((4, 14), 30.0)}, "30.0, which is no angle in rad"),
    ],
)
def test_actions_that_cannot_be_used_are_errors(made, answer, named):
    _, policy = made(answering(answer), n_action_steps=3)
    with pytest.raises(ActionError, match=named) as caught:
        policy.select_action(batch_of(policy)[0])
    assert f"127.0.0.1:{policy.config.port}" in str(caught.value)


@pytest.mark.parametrize(
    "answer, named",
    [
        (TRACEBACK, "KeyError: 'observation/image'"),
        (b"\xc1", "does not speak openpi's protocol"),
        (b"\x05", "a int instead of a dictionary"),
    ],
)
def test_failures_of_the_server_are_errors(made, answer, named):
    server, policy = made(answering(answer))
    batch, _ = batch_of(policy)
    with pytest.raises(PolicyServerError, match=named) as caught:
        policy.select_action(batch)
    assert f"127.0.0.1:{policy.config.port}" in str(caught.value)
    server.answer = counting  # and when it is well again, so is the policy
    assert policy.select_action(batch).shape == (1, 14) and server.connections == 2


def test_a_dead_server_is_an_error_at_once(made):
    server, policy = made()
    batch, _ = batch_of(policy)
    for _ in range(4):
        policy.select_action(batch)
    server.__exit__()
    for named in ("has closed the connection", "cannot be reached"):
        begun = time.monotonic()
        with pytest.raises(PolicyServerError, match=named) as caught:
            policy.select_action(batch)
        assert time.monotonic() - begun < 10.0 and f"127.0.0.1:{policy.config.port}" in str(caught.value)


def test_a_late_answer_is_never_taken_for_the_next_one(made):
    overdue = threading.Event()

    def slow_once(observation, number):
        if number == 1:
            overdue.wait()
        return counting(observation, number)

    _, policy = made(slow_once, response_timeout_s=2.0, first_response_timeout_s=30.0)
    batch, _ = batch_of(policy)
    for _ in range(4):
        policy.select_action(batch)
    with pytest.raises(PolicyServerError, match=r"has not answered within 2 s"):
        policy.select_action(batch)
    overdue.set()
    assert round(float(policy.select_action(batch)[0, 0]) * 1000) == 200


def test_the_first_answer_may_take_longer(made):
    def compiling(observation, number):
        time.sleep(0.6 if number == 0 else 0.0)
        return counting(observation, number)

    _, policy = made(compiling, response_timeout_s=0.4, first_response_timeout_s=30.0)
    assert policy.select_action(batch_of(policy)[0]).shape == (1, 14)


STOPPED = """
import sys, threading
from tests.openpi_server import OpenpiServer, wave
with OpenpiServer(wave) as server:
    print(server.port, flush=True)
    sys.stdin.read()
"""


def test_a_stopped_server_that_does_not_even_read(made):
    """More bytes than the sockets hold: the send itself must come to an end."""
    process = subprocess.Popen(
        [sys.executable, "-c", STOPPED],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        port = int(process.stdout.readline())
        config = YamOpenpiConfig(
            host="127.0.0.1", port=port, image_keys={"top": "image"}, image_size=(2000, 2000), response_timeout_s=0.5
        )
        policy = get_policy_class("yam_openpi")(config)
        batch, _ = batch_of(policy)
        policy.select_action(batch)
        policy.reset()
        os.kill(process.pid, signal.SIGSTOP)
        begun = time.monotonic()
        with pytest.raises(PolicyServerError, match="has not answered within"):
            policy.select_action(batch)
        assert time.monotonic() - begun < 20.0
        policy.close()
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()


def test_a_camera_that_the_robot_lacks(made):
    server, policy = made(image_keys={"front": "observation/image"})
    with pytest.raises(ConfigError, match="'front', of which there is no colour image; the robot has: top"):
        policy.select_action(batch_of(policy)[0])
    assert server.observations == []


def test_degrees_do_not_reach_a_server_of_radians(made):
    server, policy = made()
    degrees = {"observation.state": np.full(14, 20.0, dtype=np.float32)}
    with pytest.raises(ConfigError, match="20.0, which is no angle in rad"):
        policy.select_action(batch_of(policy, **degrees)[0])
    assert server.observations == []


def test_velocities_are_no_angles(made):
    _, policy = made(answering(zeros()), action_dim=14)
    state = {"observation.state": np.array([0.1] * 14 + [9.0] * 14, dtype=np.float32)}
    assert policy.select_action(batch_of(policy, **state)[0]).shape == (1, 14)


def test_degrees_where_both_speak_them(made):
    degrees = {"actions": np.full((4, 14), 30.0)}
    _, policy = made(answering(degrees), metadata={"angle_unit": "deg"}, angle_unit="deg")
    assert float(policy.select_action(batch_of(policy)[0])[0, 0]) == 30.0


@pytest.mark.parametrize(
    "metadata, fields, named",
    [
        ({"angle_unit": "deg"}, {}, "its angle_unit is 'deg', --policy.angle_unit is 'rad'"),
        ({"action_space": "joint_velocity"}, {}, "joint_velocity"),
        ({"action_dim": 8}, {"action_dim": 14}, "its action_dim is 8"),
        ({"image_resolution": [180, 320]}, {}, r"--policy.image_size=\[180, 320\]"),
        ({"action_horizon": 16}, {"n_action_steps": 20}, "plans 16"),
        (b"\xc1", {}, "does not speak openpi's protocol"),
        ("hello", {}, "text instead of msgpack: 'hello'"),
    ],
)
def test_a_server_that_does_not_fit_is_refused(made, metadata, fields, named):
    _, config = made(metadata=metadata, connect=False, **fields)
    with pytest.raises(YamError, match=named) as caught:
        get_policy_class("yam_openpi")(config)
    assert f"127.0.0.1:{config.port}" in str(caught.value)


def test_metadata_that_fit(made):
    metadata = GOLDEN_METADATA | {"angle_unit": "rad", "image_resolution": [180, 320], "action_horizon": 50}
    made(metadata=metadata, image_size=(180, 320), n_action_steps=50)


def test_api_key(made, monkeypatch):
    monkeypatch.setenv("LAB_KEY", "secret")
    _, policy = made(api_key="secret", api_key_env="LAB_KEY")
    policy.select_action(batch_of(policy)[0])
    monkeypatch.setenv("LAB_KEY", "wrong")
    _, config = made(api_key="secret", api_key_env="LAB_KEY", connect=False)
    with pytest.raises(PolicyServerError, match=r"HTTP status 401; check the API key") as caught:
        get_policy_class("yam_openpi")(config)
    assert "wrong" not in str(caught.value)
    monkeypatch.delenv("LAB_KEY")
    with pytest.raises(ConfigError, match="LAB_KEY, which is not set"):
        get_policy_class("yam_openpi")(config)


def test_no_server_there():
    with OpenpiServer(counting) as server:
        port = server.port
    config = YamOpenpiConfig(host="127.0.0.1", port=port, connect_timeout_s=0.6)
    begun = time.monotonic()
    with pytest.raises(PolicyServerError, match=f"127.0.0.1:{port} cannot be reached .*refused.*--policy.host"):
        get_policy_class("yam_openpi")(config)
    assert 0.5 < time.monotonic() - begun < 15.0


@pytest.mark.parametrize("host", ["no such host", "ws://", "ws://["])
def test_addresses_that_are_none(host):
    with pytest.raises(YamError):
        get_policy_class("yam_openpi")(YamOpenpiConfig(host=host, connect_timeout_s=0.5))


@pytest.mark.parametrize(
    "fields",
    [
        {"response_timeout_s": 0.0},
        {"connect_timeout_s": float("nan")},
        {"n_action_steps": 0},
        {"action_dim": 0},
        {"image_size": (0, 224)},
        {"image_keys": {"a": "x", "b": "x"}},
        {"image_keys": {"a": "observation/state"}},
    ],
)
def test_wrong_fields_are_named(fields):
    with pytest.raises(ConfigError, match=next(iter(fields))):
        YamOpenpiConfig(**fields).validate_features()


def test_it_is_not_trained_here(made):
    _, policy = made()
    for call in (policy.config.get_optimizer_preset, policy.get_optim_params, lambda: policy.forward({})):
        with pytest.raises(ConfigError, match="train"):
            call()


def test_without_the_extra_it_says_which_one():
    program = """
    import sys
    sys.modules["msgpack"] = None  # as if it were not installed
    try:
        import lerobot_robot_yam.openpi.connection
    except ValueError as error:
        print(type(error).__name__, error)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    assert "ConfigError" in done.stdout and "msgpack" in done.stdout and "lerobot_robot_yam[openpi]" in done.stdout


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


def test_rtc_with_nothing_left_of_the_running_chunk(made):
    _, policy = made(answering({"actions": np.full((6, 14), 1.0)}))
    policy.config.rtc_config = RTCConfig(execution_horizon=10)
    policy.init_rtc_processor()
    for left in (torch.zeros(10, 14), None):
        chunk = policy.predict_action_chunk(batch_of(policy)[0], inference_delay=3, prev_chunk_left_over=left)
        assert torch.equal(chunk, torch.ones(1, 6, 14))
