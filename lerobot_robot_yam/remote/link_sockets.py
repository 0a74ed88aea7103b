"""The sockets of host and clients: ZeroMQ over TCP, with CURVE where there are keys.

Commands go over DEALER and ROUTER, states over PUB and SUB, which keep the newest only. All queues are short: what
cannot be delivered now is worth nothing later.
"""

import contextlib
from pathlib import Path
from typing import Any

import zmq
from zmq.auth.thread import ThreadAuthenticator

from lerobot_robot_yam.errors import BusError, ConfigError
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.link_keys import CLIENTS, HOST_KEY, LinkKey
from lerobot_robot_yam.remote.link_messages import MOST_ANSWER_BYTES, MOST_BYTES, Message, States, decode, encode

_OPTIONS = {
    zmq.LINGER: 0,
    zmq.SNDHWM: 64,  # messages: at 60 Hz, with two arms, half a second of commands
    zmq.RCVHWM: 64,
    zmq.SNDBUF: 1 << 18,  # bytes of the kernel: 0.3 s of states
    zmq.RCVBUF: 1 << 18,
    # The kernel ends connections that the network has forgotten, 3 to 4 s later. ZMTP's own heartbeat would, too, but
    # libzmq 4.3.5 aborts (`!_io_error`) when one is due on a full connection whose other end has gone.
    zmq.TCP_KEEPALIVE: 1,
    zmq.TCP_KEEPALIVE_IDLE: 1,  # s
    zmq.TCP_KEEPALIVE_INTVL: 1,  # s
    zmq.TCP_KEEPALIVE_CNT: 3,
    zmq.TCP_MAXRT: 3000,  # ms for data that is not acknowledged
    zmq.HANDSHAKE_IVL: 5000,  # ms to exchange keys: a connection that never begins to is not kept for 30 s
    zmq.RECONNECT_IVL: 100,  # ms
    zmq.RECONNECT_IVL_MAX: 1000,  # ms
}

Socket = zmq.Socket[bytes]


def _socket(context: "zmq.Context[Socket]", kind: int, most_bytes: int) -> Socket:
    socket: Socket = context.socket(kind)
    for option, value in {**_OPTIONS, zmq.MAXMSGSIZE: most_bytes}.items():
        socket.setsockopt(option, value)
    if kind in (zmq.PUB, zmq.SUB):
        socket.setsockopt(zmq.CONFLATE, 1)
    return socket


class ClientSockets:
    """A client's two sockets.

    Args:
        address: the host's.
        key: this client's; None: none, which only a host on this computer takes.
        states: False: without the socket for states.
        also: a descriptor that ends a wait when it can be read, and is not read here; None: none.

    Attributes:
        commands, states: the sockets.
    """

    def __init__(self, address: HostAddress, key: LinkKey | None, states: bool = True, also: int | None = None):
        self._context: zmq.Context[Socket] = zmq.Context()
        self._poller = zmq.Poller()
        self.commands = _socket(self._context, zmq.DEALER, MOST_ANSWER_BYTES)
        self.commands.setsockopt(zmq.IMMEDIATE, 1)  # nothing waits for a connection that is not there
        self._connect(self.commands, address.commands, key)
        self.states: Socket | None = None
        if states:
            self.states = _socket(self._context, zmq.SUB, MOST_BYTES)
            self.states.setsockopt(zmq.SUBSCRIBE, b"")
            self._connect(self.states, address.states, key)
        if also is not None:
            self._poller.register(also, zmq.POLLIN)

    def _connect(self, socket: Socket, endpoint: str, key: LinkKey | None) -> None:
        if key is not None:
            socket.curve_serverkey, socket.curve_publickey = key.host.encode(), key.public.encode()
            socket.curve_secretkey = key.secret.encode()
        socket.connect(endpoint)
        self._poller.register(socket, zmq.POLLIN)

    def send(self, message: Message) -> bool:
        """Send to the host, if it is there; False: it is not, and the message is gone."""
        try:
            self.commands.send(encode(message), zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def receive(self) -> Message | None:
        """Return the host's next message besides states, None if there is none. Raises LinkError: it is no message."""
        return self._next(self.commands)

    def newest_states(self) -> States | None:
        """Return the newest states, None if there are no new ones. Raises LinkError: it is no message."""
        assert self.states is not None
        message = self._next(self.states)
        return message if isinstance(message, States) else None

    @staticmethod
    def _next(socket: Socket) -> Message | None:
        try:
            return decode(socket.recv(zmq.NOBLOCK))
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
        keys: the directory of its keys; None: none.

    Raises:
        ConfigError: without keys nothing listens beyond this computer; or the host's own key cannot be read.
        BusError: the ports cannot be had.
    """

    def __init__(self, address: HostAddress, keys: Path | None):
        if keys is None and not address.is_loopback:
            raise ConfigError(
                f"{address} can be reached from other computers, and no client is paired: whoever is in the network "
                "could drive the arms. Make keys with `yam-host pair`, or listen on 127.0.0.1"
            )
        key = None if keys is None else LinkKey.load(keys / HOST_KEY)
        self._context: zmq.Context[Socket] = zmq.Context()
        self._authenticator: ThreadAuthenticator | None = None
        try:
            if keys is not None and key is not None:
                self._authenticator = ThreadAuthenticator(self._context)
                self._authenticator.start()
                self._authenticator.configure_curve(domain="*", location=str(keys / CLIENTS))
                self._authenticator.certs.setdefault("*", {})[key.public.encode()] = True  # of `yam-host status`
            self.commands = _socket(self._context, zmq.ROUTER, MOST_BYTES)
            self.states = _socket(self._context, zmq.PUB, MOST_BYTES)
            for socket, endpoint in ((self.commands, address.commands), (self.states, address.states)):
                if key is not None:
                    socket.curve_server = True
                    socket.curve_publickey, socket.curve_secretkey = key.public.encode(), key.secret.encode()
                socket.bind(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise BusError(f"cannot listen on {address}: {error}; does another yam-host run?") from error

    def receive(self, within_s: float) -> tuple[bytes, bytes] | None:
        """Return (client, message), None if nothing comes in that time. A message of several parts becomes empty."""
        if not self.commands.poll(round(within_s * 1e3)):
            return None
        client, *parts = self.commands.recv_multipart()
        return client, parts[0] if len(parts) == 1 else b""

    def answer(self, client: bytes, message: Message) -> None:
        """Send to a client; one that has gone, or does not listen, gets nothing."""
        with contextlib.suppress(zmq.ZMQError):
            self.commands.send_multipart([client, encode(message)], zmq.NOBLOCK)

    def publish(self, states: States) -> None:
        """Send to all who watch. Only one thread may call this."""
        with contextlib.suppress(zmq.Again):
            self.states.send(encode(states), zmq.NOBLOCK)

    def close(self) -> None:
        """Let go. Idempotent."""
        if self._authenticator is not None and self._authenticator.is_alive():
            self._authenticator.stop()
        self._context.destroy(linger=0)
