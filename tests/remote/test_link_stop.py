"""What a link tells of this computer's emergency stop is what that is when it is told."""

import pytest

from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.link import Link
from lerobot_robot_yam.remote.link_messages import decode
from lerobot_robot_yam.remote.link_sockets import HostSockets
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


def test_a_link_tells_of_a_stop_with_its_next_beat(sockets, host):
    """It looks at the latch less often than it beats, and another link of this computer may have told of it already."""
    stop, link = EmergencyStop(), Link(host, {})

    def next_beat():
        """The first that it sends from now on."""
        since_s = SYSTEM.now()
        while True:
            link.turn()
            while (received := sockets.receive(0.0)) is not None:
                beat = decode(received[1])
                if beat.sent_s > since_s:
                    return beat.stopped

    try:
        assert next_beat() is False
        for _ in range(6):
            stop.latch("a test")
            assert next_beat() is True
            stop.release()
            assert next_beat() is False
    finally:
        stop.release()
        link.close()
