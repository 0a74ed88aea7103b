"""The sockets of host and clients: ZeroMQ over TCP, with CURVE where there are keys.

Commands go over DEALER and ROUTER, states over PUB and SUB, which keep the newest only. All queues are short: what
cannot be delivered now is worth nothing later.
"""

import contextlib
import logging
from collections.abc import Iterator
from typing import Any

from lerobot_robot_yam.errors import BusError, ConfigError, LinkError
from lerobot_robot_yam.remote.wire.curve_keys import ClientKey, HostKeys
from lerobot_robot_yam.remote.wire.host_address import HostAddress
from lerobot_robot_yam.remote.wire.link_messages import MOST_ANSWER_BYTES, MOST_BYTES
from lerobot_robot_yam.system.own_commands import install_extra

try:
    import zmq
    from zmq.auth.thread import ThreadAuthenticator
except ImportError as error:
    raise ConfigError(f"arms on another computer need pyzmq ({error}); {install_extra('remote')}") from error

logger = logging.getLogger(__name__)

_QUEUED = 64  # commands: at 60 Hz, with two arms, half a second of them
_BUFFER_BYTES = 1 << 18  # of the kernel: 0.3 s of states
_ALIVE_MS, _DEAD_MS = 1000, 3000  # ZMTP's own heartbeat: ends connections that the network has forgotten
_GREETING_MS = 5000  # for keys to be exchanged: a connection that never begins to is not kept for 30 s
_RETRY_MS, _RETRY_MOST_MS = 100, 1000

Socket = zmq.Socket[bytes]


def _prepare(socket: Socket, queued: int, most_bytes: int) -> Socket:
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.SNDHWM, queued)
    socket.setsockopt(zmq.RCVHWM, queued)
    socket.setsockopt(zmq.MAXMSGSIZE, most_bytes)
    socket.setsockopt(zmq.SNDBUF, _BUFFER_BYTES)
    socket.setsockopt(zmq.RCVBUF, _BUFFER_BYTES)
    socket.setsockopt(zmq.HEARTBEAT_IVL, _ALIVE_MS)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, _DEAD_MS)
    socket.setsockopt(zmq.HANDSHAKE_IVL, _GREETING_MS)
    socket.setsockopt(zmq.RECONNECT_IVL, _RETRY_MS)
    socket.setsockopt(zmq.RECONNECT_IVL_MAX, _RETRY_MOST_MS)
    return socket


class ClientSockets:
    """A client's two sockets.

    Args:
        address: the host.
        key: this client's; None: none, which only a host on this computer takes.
        states: False: without the one for states.
        also: a descriptor that ends a wait when it can be read, and is not read here; None: none.

    Attributes:
        commands, states: the sockets.
    """

    def __init__(self, address: HostAddress, key: ClientKey | None, states: bool = True, also: int | None = None):
        self._context = zmq.Context()
        self.commands = _prepare(self._context.socket(zmq.DEALER), _QUEUED, MOST_ANSWER_BYTES)
        self.commands.setsockopt(zmq.IMMEDIATE, 1)  # nothing waits for a connection that is not there
        self._keyed(self.commands, key).connect(address.commands)
        self.states: Socket | None = None
        if states:
            self.states = _prepare(self._context.socket(zmq.SUB), 1, MOST_BYTES)
            self.states.setsockopt(zmq.CONFLATE, 1)
            self.states.setsockopt(zmq.SUBSCRIBE, b"")
            self._keyed(self.states, key).connect(address.states)
        self._poller = zmq.Poller()
        for polled in (self.commands, self.states, also):
            if polled is not None:
                self._poller.register(polled, zmq.POLLIN)

    @staticmethod
    def _keyed(socket: Socket, key: ClientKey | None) -> Socket:
        if key is not None:
            socket.curve_serverkey = key.host
            socket.curve_publickey, socket.curve_secretkey = key.public, key.secret
        return socket

    def send(self, message: bytes) -> bool:
        """Send to the host, if it is there; False: it is not, and the message is gone."""
        try:
            self.commands.send(message, zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def receive(self) -> bytes | None:
        """The next message of the host besides states, None if there is none."""
        try:
            return self.commands.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None

    def newest_states(self) -> bytes | None:
        """The newest message of states, None if there is no new one."""
        assert self.states is not None
        try:
            return self.states.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None

    def ignore(self, also: int) -> None:
        """Wait no longer for the other descriptor."""
        self._poller.unregister(also)

    def wait(self, within_s: float) -> set[Any]:
        """Wait until something has come; returns the sockets, and the other descriptor, that have something."""
        return {polled for polled, _ in self._poller.poll(max(0, round(within_s * 1e3)))}

    def close(self) -> None:
        """Let go. Idempotent."""
        self._context.destroy(linger=0)


class HostSockets:
    """The host's two sockets, which listen.

    Args:
        address: on which to listen.
        keys: the host's and its clients'; None: none.

    Raises:
        ConfigError: without keys nothing listens beyond this computer.
        BusError: the ports cannot be had.
    """

    def __init__(self, address: HostAddress, keys: HostKeys | None):
        if keys is None and not address.is_loopback:
            raise ConfigError(
                f"{address} can be reached from other computers, and no client is paired: whoever is in the network "
                "could drive the arms. Make keys with `yam-host pair`, or listen on 127.0.0.1"
            )
        self._context = zmq.Context()
        self._authenticator: ThreadAuthenticator | None = None
        try:
            if keys is not None:
                self._authenticator = ThreadAuthenticator(self._context)
                self._authenticator.start()
                self._authenticator.configure_curve(domain="*", location=str(keys.clients))
                self._authenticator.certs.setdefault("*", {})[keys.public] = True  # of `yam-host status`
            self.commands = _prepare(self._context.socket(zmq.ROUTER), _QUEUED, MOST_BYTES)
            self.states = _prepare(self._context.socket(zmq.PUB), 1, MOST_BYTES)
            self.states.setsockopt(zmq.CONFLATE, 1)
            for socket, endpoint in ((self.commands, address.commands), (self.states, address.states)):
                if keys is not None:
                    socket.curve_server = True
                    socket.curve_publickey, socket.curve_secretkey = keys.public, keys.secret
                socket.bind(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise BusError(f"cannot listen on {address}: {error}; does another yam-host run?") from error
        self._poller = zmq.Poller()
        self._poller.register(self.commands, zmq.POLLIN)

    def receive(self, within_s: float) -> tuple[bytes, bytes] | None:
        """(client, message), None if nothing comes in that time. What has more than one part is dropped."""
        if not self._poller.poll(round(within_s * 1e3)):
            return None
        parts = self.commands.recv_multipart()
        return (parts[0], parts[1]) if len(parts) == 2 else (parts[0], b"")

    def answer(self, client: bytes, message: bytes) -> None:
        """Send to a client; one that has gone, or does not listen, gets nothing."""
        with contextlib.suppress(zmq.ZMQError):
            self.commands.send_multipart([client, message], zmq.NOBLOCK)

    def publish(self, message: bytes) -> None:
        """Send to all who watch. Of one thread."""
        try:
            self.states.send(message, zmq.NOBLOCK)
        except zmq.Again:
            pass

    def close(self) -> None:
        """Let go. Idempotent."""
        if self._authenticator is not None and self._authenticator.is_alive():
            self._authenticator.stop()
        self._context.destroy(linger=0)


@contextlib.contextmanager
def reaching(address: HostAddress) -> Iterator[None]:
    """Errors of ZeroMQ inside the block become ours. Raises LinkError: names the host."""
    try:
        yield
    except zmq.ZMQError as error:
        raise LinkError(f"{address}: {error}") from error
