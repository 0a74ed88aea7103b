"""What a policy cannot use is refused in words that the client shows; nobody else notices, and the server goes on."""

import random
import re
import socket

import numpy as np
import pytest
from lerobot.policies import get_policy_class
from websockets.exceptions import ConnectionClosed, InvalidStatus

from lerobot_robot_yam.errors import ConfigError, ObservationError, PolicyServerError
from lerobot_robot_yam.face.openpi.chunk_server import ChunkServer, _message
from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from lerobot_robot_yam.face.openpi.messages import encode_message
from lerobot_robot_yam.face.openpi.served_policy import ServedPolicy
from tests.face.openpi.conftest import batch_of
from tests.support.tiny_policies import HEIGHT, WIDTH, N, observations

CAMERAS = {"top": "images/top", "wrist_left": "images/wrist_left"}


@pytest.fixture(scope="module")
def act(checkpoint):
    return ServedPolicy(str(checkpoint("act")))


@pytest.fixture
def seen():
    return observations("act", 1)[0]


def our_policy(served, **fields):
    options = {"image_size": (HEIGHT, WIDTH), "image_keys": CAMERAS} | fields
    config = YamOpenpiConfig(host="127.0.0.1", port=served.port, response_timeout_s=30.0, **options)
    return get_policy_class("yam_openpi").from_pretrained(None, config=config)


def image(*shape, dtype=np.uint8):
    return {"observation.images.top": np.zeros(shape, dtype=dtype)}


def state(*values):
    return {"observation.state": np.array(values, dtype=np.float32)}


WRONG = [
    ({"observation.images.top": None}, "observation.images.top is a NoneType; it has to be an array"),
    (image(HEIGHT, WIDTH), rf"top is uint8 of the shape \({HEIGHT}, {WIDTH}\)"),
    (image(HEIGHT, WIDTH, 4), r"has to be uint8, \(height, width, 3\)"),
    (image(HEIGHT, WIDTH, 3, dtype=np.float32), "top is float32"),
    (image(224, 224, 3), f"top has 224 x 224 pixels .*trained with {HEIGHT} x {WIDTH}"),
    (state(*[0.1] * 7), rf"state is float32 of the shape \(7,\); this policy has to see {N} floating-point numbers"),
    (state(*[0.1] * 13, np.nan), "observation.state is not finite"),
    ({"observation.state": np.full(N, 1e300)}, "observation.state is not finite"),
    ({"observation.state": np.zeros(N, dtype=np.int64)}, "observation.state is int64"),
    ({"observation.state": [0.0] * N}, "observation.state is a list"),
    ({"endpoint": "shutdown"}, "the endpoint is 'shutdown'; there are only 'infer' and 'reset'"),
    ({"endpoint": np.zeros(2)}, "the endpoint is array"),
]


@pytest.mark.parametrize("wrong, named", WRONG)
def test_a_wrong_observation_is_refused(act, serve, seen, wrong, named, caplog):
    served = serve(act)
    client = served.client()
    answer = client.ask(seen | wrong)
    assert answer.startswith("yam-policy-server: ") and re.search(named, answer)
    assert "Traceback" not in answer + caplog.text
    with pytest.raises(ConnectionClosed, match="1011"):  # as openpi's server does after a failure
        client.ask(seen)
    assert served.client().ask(seen)["actions"].shape == (6, N)


def test_all_that_is_missing_is_named(act, serve, seen):
    answer = serve(act).client().ask({"observation/state": seen["observation.state"], "images": {"front": 1}})
    assert "has no observation.images.top, observation.images.wrist_left; this policy has to see" in answer
    assert answer.endswith("was sent observation.state, observation.images.front")


def test_what_a_client_sends_cannot_garble_a_log(act, serve, caplog):
    answer = serve(act).client().ask({"\x1b[2J\nINFO all is well" * 1000: 1})
    (told,) = [record.getMessage() for record in caplog.records if "was refused" in record.getMessage()]
    assert answer.isprintable() and told.isprintable() and max(len(answer), len(told)) < 2100


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"image_keys": {"top": "images/top"}}, "has to see observation.images.wrist_left, which --policy.image_keys"),
        ({"image_size": (224, 224)}, rf"wants images of \[{HEIGHT}, {WIDTH}\]; set '--policy.image_size"),
        ({"angle_unit": "deg"}, "says that its angle_unit is 'rad', --policy.angle_unit is 'deg'"),
    ],
)
def test_our_client_refuses_what_does_not_fit_before_an_arm_is_energised(act, serve, fields, says):
    with pytest.raises(ConfigError, match=says):
        our_policy(serve(act), **fields)


def test_our_client_shows_what_the_server_says_of_a_wrong_state(act, serve):
    policy = our_policy(serve(act))
    images = {f"observation.images.{camera}": np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8) for camera in CAMERAS}
    with pytest.raises(PolicyServerError, match=rf"\(7,\); this policy has to see {N} floating-point numbers"):
        policy.select_action(batch_of(policy, cameras=(), width=7, **images)[0])
    policy.close()


MALFORMED = [
    ("observation", "is a dictionary, not text"),
    (b"", "no message of openpi's protocol"),
    (b"\xc1", "no message of openpi's protocol"),
    (b"\x05", "is a dictionary, not int"),
    (b"\x81" * 100_000, "no message of openpi's protocol"),  # dictionaries in dictionaries
    (encode_message({"a": np.zeros(3)}).replace(b"<f8", b"|O8"), "no message of openpi's protocol"),  # pointers
    (encode_message({"a": np.zeros(3)}).replace(b"<f8", b"(,f"), "no message of openpi's protocol"),
]


@pytest.mark.parametrize(
    "data, named", MALFORMED, ids=["text", "empty", "no type", "number", "deep", "pointers", "type"]
)
def test_a_malformed_message_is_refused(act, serve, seen, data, named):
    served = serve(act)
    assert named in served.client().ask(data)
    assert served.client().ask(seen)["actions"].shape == (6, N)


def test_bytes_gone_wrong_are_refused_or_understood(act, seen):
    """Whatever bits flip: no other error, so that none is taken for one of the policy's."""
    small = {"observation/state": seen["observation.state"], "images": {"top": np.zeros((2, 2, 3), dtype=np.uint8)}}
    whole, dice, refused = encode_message(small), random.Random(1), 0
    for _ in range(5000):
        data = bytearray(whole)
        for _ in range(dice.randint(1, 4)):
            data[dice.randrange(len(data))] = dice.randrange(256)
        with pytest.raises(ObservationError):  # an image is missing, or more
            act.question(_message(bytes(data[: dice.randint(1, len(data))])))
        refused += 1
    assert refused == 5000


def test_a_message_that_is_too_large_ends_its_connection(act, serve, seen):
    served = serve(act)
    other = served.client()
    with pytest.raises(ConnectionClosed, match="1009"):
        served.client().ask(bytes(33 * 2**20))
    assert other.ask(seen)["actions"].shape == (6, N)


def test_a_policy_that_fails_says_so_and_begins_anew(serve, checkpoint, caplog):
    policy = ServedPolicy(str(checkpoint("vqbet, history")), any_image_size=True)  # VQ-BeT does not resize images
    (seen,) = observations("vqbet, history", 1)
    served = serve(policy)
    assert "the policy failed: RuntimeError" in served.client().ask(seen | image(200, 200, 3))
    assert "Traceback" in caplog.text
    assert served.client().ask(seen)["actions"].shape == (1, N)


def test_others_do_not_disturb_an_episode(serve):
    """A history is of one client: garbage does not touch it, and whoever asks in between begins a new episode."""
    seen = observations("act, ensembling", 4)
    served = serve("act, ensembling")
    actor = served.client()
    first = [actor.ask(observation)["actions"] for observation in seen]
    assert not np.array_equal(first[3], served.client().ask(seen[3])["actions"])  # it has seen nothing before
    assert actor.metadata["stateful"] and actor.ask({"endpoint": "reset"}) == "reset successful"
    for observation, expected in zip(seen, first, strict=True):
        for wrong in (b"\xc1", {}, {"endpoint": "stop"}):
            assert "yam-policy-server" in served.client().ask(wrong)
        assert np.array_equal(actor.ask(observation)["actions"], expected)


def test_a_client_that_dies_while_it_waits(act, serve, seen):
    served = serve(act)
    client = served.client()
    client.connection.send(encode_message(seen))
    client.connection.socket.shutdown(socket.SHUT_RDWR)
    assert served.client().ask(seen)["actions"].shape == (6, N)


def test_several_environments_need_a_policy_without_memory(serve):
    policy = our_policy(serve("vqbet, history"), image_keys={"top": "images/top"})
    images = {"observation.images.top": np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)}
    batch, _ = batch_of(policy, cameras=(), rows=2, **images)
    with pytest.raises(ConfigError, match="cannot tell 2 environments apart; set --eval.batch_size=1"):
        policy.select_action(batch)
    policy.close()


def test_only_who_has_the_key_is_let_in(act, serve, seen):
    served = serve(act, api_key="sesame")
    for headers in (None, {"Authorization": "Api-Key other"}, {"Authorization": "Api-Key sésame"}):
        with pytest.raises(InvalidStatus, match="401"):
            served.client(additional_headers=headers)
    client = served.client(additional_headers={"Authorization": "Api-Key sesame"})
    assert client.ask(seen)["actions"].shape == (6, N)


def test_no_page_in_a_browser_is_let_in(act, serve):
    with pytest.raises(InvalidStatus, match="403"):
        serve(act).client(origin="http://127.0.0.1:8000")


def test_only_so_many_clients(act, serve, seen):
    served = serve(act)
    clients = [served.client() for _ in range(8)]
    with pytest.raises(ConnectionClosed, match="1013 .*there are 8 clients already"):
        served.client()
    assert clients[0].ask(seen)["actions"].shape == (6, N)


def test_the_end_of_the_server_ends_its_connections(act, serve, seen):
    served = serve(act)
    client = served.client()
    client.ask(seen)
    served.server.close()
    with pytest.raises(ConnectionClosed, match="1001 .*the server ends"):
        client.ask(seen)


def test_a_port_that_is_taken(act, serve):
    with pytest.raises(ConfigError, match="nobody can listen on 127.0.0.1 port"):
        ChunkServer(act, port=serve(act).port)
