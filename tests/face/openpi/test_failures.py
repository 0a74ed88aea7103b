"""Whatever goes wrong between a policy and its openpi server is an error that names the server, never an action."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
from lerobot.policies import get_policy_class

from lerobot_robot_yam.errors import ActionError, ConfigError, PolicyServerError, YamError
from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from lerobot_robot_yam.system.own_commands import install_extra
from tests.face.openpi.conftest import batch_of
from tests.support.openpi_server import TRACEBACK, OpenpiServer, answering, counting, zeros


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
        (bytes(17 * 2**20), "more than 16 MiB, which no chunk of actions has"),
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


def test_an_episode_that_the_server_cannot_begin(made):
    def answer(observation, number):
        return TRACEBACK if observation == {"endpoint": "reset"} else counting(observation, number)

    server, policy = made(answer, {"endpoints": ["infer", "reset"]})
    batch, _ = batch_of(policy)
    policy.reset()
    with pytest.raises(PolicyServerError, match="could not begin a new episode: .*KeyError"):
        policy.select_action(batch)
    assert policy.select_action(batch).shape == (1, 14)  # on a new connection, of which the server remembers nothing
    assert server.connections == 2


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


def test_the_first_answer_of_a_server_may_take_longer_and_again_when_it_is_started_again(made):
    def compiling(observation, number):
        if number == 1:
            raise ValueError("it ends")
        time.sleep(0.6)
        return counting(observation, number)

    _, policy = made(compiling, response_timeout_s=0.4, first_response_timeout_s=30.0)
    batch, _ = batch_of(policy)
    for _ in range(4):
        policy.select_action(batch)
    with pytest.raises(PolicyServerError):
        policy.select_action(batch)
    assert policy.select_action(batch).shape == (1, 14)


STOPPED = """
import sys, threading
from tests.support.openpi_server import OpenpiServer, wave
with OpenpiServer(wave) as server:
    print(server.port, flush=True)
    sys.stdin.read()
"""


@pytest.mark.long
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


@pytest.mark.parametrize(
    "metadata, fields, named",
    [
        ({"angle_unit": "deg"}, {}, "its angle_unit is 'deg', --policy.angle_unit is 'rad'"),
        ({"action_space": "joint_velocity"}, {}, "'joint_velocity'; these arms can be driven by joint_position or"),
        ({"action_space": "joint_velocity"}, {"action_space": "joint_velocity"}, "these arms can be driven by"),
        ({"action_space": "cartesian_position"}, {}, "--policy.action_space is 'joint_position'"),
        ({"action_dim": 8}, {"action_dim": 14}, "its action_dim is 8"),
        ({"image_resolution": [180, 320]}, {}, r"'--policy.image_size=\[180,320\]'"),
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


@pytest.mark.long
def test_without_the_extra_it_says_which_one():
    program = """
    import sys
    sys.modules["msgpack"] = None  # as if it were not installed
    try:
        import lerobot_robot_yam.face.openpi.server_connection
    except Exception as error:
        print(type(error).__name__, error)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    assert "ConfigError" in done.stdout and "import of msgpack" in done.stdout
    assert install_extra("openpi") in done.stdout
