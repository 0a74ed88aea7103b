"""A served checkpoint, and a client that is as plain as openpi's."""

import contextlib
import threading

import pytest
import torch
from websockets.sync.client import connect

from lerobot_robot_yam.face.openpi.chunk_server import ChunkServer
from lerobot_robot_yam.face.openpi.messages import decode_message, encode_message
from lerobot_robot_yam.face.openpi.served_policy import ServedPolicy
from tests.support.tiny_policies import save_tiny


class Client:
    """As openpi's `WebsocketClientPolicy`: a greeting, then an answer to each message."""

    def __init__(self, port, **options):
        self.connection = connect(f"ws://127.0.0.1:{port}", compression=None, max_size=None, **options)
        self.metadata = decode_message(self.connection.recv())

    def ask(self, message):
        """The answer: a dictionary, or text. Bytes and text are sent as they are."""
        self.connection.send(encode_message(message) if isinstance(message, dict) else message)
        answer = self.connection.recv(60.0)
        return answer if isinstance(answer, str) else decode_message(answer)

    def close(self):
        self.connection.close()


class Served:
    """A server in a thread of its own."""

    def __init__(self, policy, **options):
        self.policy = policy
        self.server = ChunkServer(policy, port=0, **options)
        self._thread = threading.Thread(target=self.server.serve_forever)
        self._thread.start()
        self._stack = contextlib.ExitStack()

    @property
    def port(self):
        return self.server.port

    def client(self, **options):
        return self._stack.enter_context(contextlib.closing(Client(self.port, **options)))

    def close(self):
        self._stack.close()
        self.server.close()
        self._thread.join()


@pytest.fixture(scope="package", autouse=True)
def _one_thread():
    """For so small networks several threads cost more than they save; here and over there alike."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory):
    """Makes the checkpoints of `POLICIES`, each once."""
    made = {}

    def make(name):
        if name not in made:
            made[name] = save_tiny(tmp_path_factory.mktemp("checkpoint"), name)
        return made[name]

    return make


@pytest.fixture
def serve(checkpoint):
    """Serves a checkpoint of `POLICIES`, or a policy that is loaded."""
    with contextlib.ExitStack() as stack:

        def start(what, overrides=(), **options):
            policy = ServedPolicy(str(checkpoint(what)), overrides) if isinstance(what, str) else what
            return stack.enter_context(contextlib.closing(Served(policy, **options)))

        yield start
