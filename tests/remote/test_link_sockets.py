"""A client that nobody trusts takes no memory of the host beyond its short queues."""

import contextlib
import subprocess
import sys
import time

import psutil
import pytest
import zmq

from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.link_keys import LinkKey, pair
from lerobot_robot_yam.remote.link_messages import Beat, States, decode
from lerobot_robot_yam.remote.link_sockets import ClientSockets, HostSockets
from tests.support.hosted import free_port

STATES = States(1, "", False, [], [])
# another program: a subscriber's own socket keeps its topics, too
CROWD = """
import os, sys, time, zmq
context = zmq.Context()
socket = context.socket(int(sys.argv[2]))
socket.connect(sys.argv[1])
for _ in range(100):
    if socket.type == zmq.SUB:
        socket.setsockopt(zmq.SUBSCRIBE, os.urandom(60_000))
    else:
        socket.send(os.urandom(60_000))
    time.sleep(0.005)
context.destroy(linger=0)
"""


@pytest.fixture
def host():
    sockets = HostSockets(HostAddress("127.0.0.1", free_port()), None)
    yield sockets
    sockets.close()


@pytest.mark.parametrize("kind", [zmq.SUB, zmq.DEALER], ids=["topics", "messages"])
def test_what_a_stranger_sends_to_the_port_of_states_is_not_kept(host, kind):
    port = host.states.getsockopt_string(zmq.LAST_ENDPOINT)
    own = psutil.Process()
    before = own.memory_info().rss
    with subprocess.Popen([sys.executable, "-c", CROWD, port, str(int(kind))]) as crowd:
        while crowd.poll() is None:
            host.publish(STATES)
            time.sleep(0.002)
    assert own.memory_info().rss - before < 30 * 2**20


def test_a_host_with_keys_hears_paired_clients_only(tmp_path):
    for name in ("host", "other"):
        pair(tmp_path / name, "one", tmp_path / f"{name}.json")
    paired, other = (LinkKey.load(tmp_path / f"{name}.json") for name in ("host", "other"))
    address = HostAddress("127.0.0.1", free_port())
    with contextlib.ExitStack() as open_:
        host = open_.enter_context(contextlib.closing(HostSockets(address, tmp_path / "host")))
        keys = (None, other, LinkKey(other.public, other.secret, paired.host))
        strangers = [open_.enter_context(contextlib.closing(ClientSockets(address, key))) for key in keys]
        heard = []
        for client in (*strangers, open_.enter_context(contextlib.closing(ClientSockets(address, paired)))):
            deadline = time.monotonic() + (20.0 if client not in strangers else 0.3)
            while time.monotonic() < deadline and not (heard and client not in strangers):
                client.send(Beat(0, "", 0.0, client in strangers))
                host.publish(STATES)
                heard += [decode(received[1]) for received in [host.receive(0.01)] if received is not None]
        assert heard and not any(message.stopped for message in heard)
        assert all(stranger.newest_states() is None for stranger in strangers)


def test_states_come_while_a_client_beats_also_after_its_host_was_away():
    address = HostAddress("127.0.0.1", free_port())
    client = ClientSockets(address, None)
    try:
        for _ in range(2):
            host = HostSockets(address, None)
            deadline = time.monotonic() + 20.0
            while (states := client.newest_states()) is None:
                assert time.monotonic() < deadline
                client.send(Beat(0, "", 0.0, False))
                host.publish(STATES)
                client.wait(0.01)
            assert states == STATES
            host.close()
            while client.newest_states() is not None:
                pass
    finally:
        client.close()
