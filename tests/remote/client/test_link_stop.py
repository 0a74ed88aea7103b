"""What a link tells of this computer's emergency stop is what that is when it is told."""

import pytest

from lerobot_robot_yam.remote.client.host_question import Host
from lerobot_robot_yam.remote.client.link import Link
from lerobot_robot_yam.remote.client.state_mirror import StateMirror
from lerobot_robot_yam.remote.wire.host_address import HostAddress
from lerobot_robot_yam.remote.wire.link_messages import unpack_beat
from lerobot_robot_yam.remote.wire.transport import HostSockets
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.clock import SYSTEM
from tests.support.hosted import free_port


@pytest.fixture
def sockets():
    sockets = HostSockets(HostAddress("127.0.0.1", free_port()), None)
    yield sockets
    sockets.close()


@pytest.fixture
def host(sockets):
    endpoint = sockets.commands.last_endpoint.decode()
    return Host(HostAddress.of(endpoint.removeprefix("tcp://")))


def test_each_link_tells_of_a_stop_with_its_next_beat(sockets, host):
    """A link looks at the latch less often than it beats, and the links of one computer at different times."""
    stop, links = EmergencyStop(), [Link(host, StateMirror([], [], {}), {}, {}) for _ in range(2)]

    def next_beats(since_s):
        """Of each link the first that it has sent since then."""
        found = {}
        while len(found) < len(links):
            for link in links:
                link.turn()
            while (received := sockets.receive(0.0)) is not None:
                beat = unpack_beat(received[1])
                if beat.sent_s > since_s:
                    found.setdefault(received[0], bool(beat.stopped))
        return list(found.values())

    try:
        assert next_beats(SYSTEM.now()) == [False, False]
        for _ in range(6):
            stop.latch("a test")
            assert next_beats(SYSTEM.now()) == [True, True]
            stop.release()
            assert next_beats(SYSTEM.now()) == [False, False]
    finally:
        stop.release()
        for link in links:
            link.close()
