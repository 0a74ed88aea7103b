"""Sockets of host and clients: ZeroMQ over TCP, with CURVE if there are keys.

Both use DEALER and ROUTER. A client asks for states with each heartbeat. PUB and SUB are no alternative: a publisher
stores each topic of a subscriber, 41 bytes for each of its bytes, without a limit. All queues are short: a message that
cannot be delivered at once is useless later.
"""

import contextlib
from pathlib import Path
from typing import Any

import zmq
from zmq.auth.thread import ThreadAuthenticator

from lerobot_robot_yam.errors import BusError, ConfigError
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.link_keys import CLIENTS, HOST_KEY, LinkKey
from lerobot_robot_yam.remote.link_messages import MOST_ANSWER_BYTES, MOST_BYTES, Beat, Message, States, decode, encode
from lerobot_robot_yam.system.clock import SYSTEM

_OPTIONS = {
    zmq.LINGER: 0,
    zmq.SNDHWM: 64,  # maximum number of queued messages: half a second of commands, at 60 Hz and with two arms
    zmq.RCVHWM: 64,
    zmq.SNDBUF: 1 << 18,  # size of the kernel's buffer, bytes: 0.3 s of states
    zmq.RCVBUF: 1 << 18,
    # Keepalive closes connections that the network has dropped, after 3 to 4 s. ZMTP's heartbeat would close them, too,
    # but libzmq 4.3.5 aborts (`!_io_error`) when a heartbeat is due on a full connection whose other end is closed.
    zmq.TCP_KEEPALIVE: 1,
    zmq.TCP_KEEPALIVE_IDLE: 1,  # silence before the first probe, s
    zmq.TCP_KEEPALIVE_INTVL: 1,  # interval between probes, s
    zmq.TCP_KEEPALIVE_CNT: 3,
    zmq.TCP_MAXRT: 3000,  # time until unacknowledged data closes a connection, ms
    zmq.HANDSHAKE_IVL: 5000,  # timeout of the key exchange, ms; the default of 30 s keeps dead connections
    zmq.RECONNECT_IVL: 100,  # first pause before a reconnect, ms
    zmq.RECONNECT_IVL_MAX: 1000,  # maximum pause before a reconnect, ms
}
_LISTENS_S = 5.0  # time for which a client gets states after it has asked for them, s
_MOST_ASKED = 64  # maximum number of messages that are read between two states: a flood must not delay states
_MOST_ASKING_BYTES = 1024  # maximum size of a message to the socket for states, bytes; the key exchange takes 350

Socket = zmq.Socket[bytes]


def _socket(context: "zmq.Context[Socket]", kind: int, most_bytes: int) -> Socket:
    socket: Socket = context.socket(kind)
    for option, value in {**_OPTIONS, zmq.MAXMSGSIZE: most_bytes}.items():
        socket.setsockopt(option, value)
    return socket


class ClientSockets:
    """Two sockets of a client.

    Args:
        address: address of the host.
        key: this client's key; only a host on this computer accepts None.
        states: whether to open the socket for states.
        also: another file descriptor that `wait` polls without reading; None: no other.

    Attributes:
        commands, states: the sockets.
    """

    def __init__(self, address: HostAddress, key: LinkKey | None, states: bool = True, also: int | None = None):
        self._context: zmq.Context[Socket] = zmq.Context()
        self._poller = zmq.Poller()
        self.commands = _socket(self._context, zmq.DEALER, MOST_ANSWER_BYTES)
        self.commands.setsockopt(zmq.IMMEDIATE, 1)  # without a connection, messages are refused instead of queued
        self._connect(self.commands, address.commands, key)
        self.states: Socket | None = None
        if states:
            self.states = _socket(self._context, zmq.DEALER, MOST_BYTES)
            self.states.setsockopt(zmq.CONFLATE, 1)  # keeps only the newest message
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
        """Send a message to the host. Without a connection, drop the message and return False. A `Beat` gets states."""
        try:
            if isinstance(message, Beat) and self.states is not None:
                self.states.send(b"", zmq.NOBLOCK)
            self.commands.send(encode(message), zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def receive(self) -> Message | None:
        """Return the host's next message other than states, or None. Raises LinkError: the message is malformed."""
        return self._next(self.commands)

    def newest_states(self) -> States | None:
        """Return the newest states; None: no new states. Raises LinkError: the message is malformed."""
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
        """Stop polling the other file descriptor `also`."""
        self._poller.unregister(also)

    def wait(self, within_s: float) -> set[Any]:
        """Wait until data has arrived. Return the readable sockets, and the other descriptor if it is readable."""
        return {polled for polled, _ in self._poller.poll(max(0, round(within_s * 1e3)))}

    def close(self) -> None:
        """Close the sockets. Idempotent."""
        self._context.destroy(linger=0)


class HostSockets:
    """Two listening sockets of the host.

    Args:
        address: address to listen on.
        keys: directory of the host's keys; None: connections are not encrypted.

    Raises:
        ConfigError: there are no keys but other computers can reach the address, or the host's key cannot be read.
        BusError: the ports cannot be bound.
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
                self._authenticator.certs.setdefault("*", {})[key.public.encode()] = True  # permits `yam-host status`
            self.commands = _socket(self._context, zmq.ROUTER, MOST_BYTES)
            self.states = _socket(self._context, zmq.ROUTER, _MOST_ASKING_BYTES)
            self.states.setsockopt(zmq.SNDHWM, 1)
            self._asked_s: dict[bytes, float] = {}  # client → time at which it last asked for states, s
            for socket, endpoint in ((self.commands, address.commands), (self.states, address.states)):
                if key is not None:
                    socket.curve_server = True
                    socket.curve_publickey, socket.curve_secretkey = key.public.encode(), key.secret.encode()
                socket.bind(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise BusError(f"cannot listen on {address}: {error}; does another yam-host run?") from error

    def receive(self, within_s: float) -> tuple[bytes, bytes] | None:
        """Return (client, message), or None after the timeout. A message with several parts becomes empty."""
        if not self.commands.poll(round(within_s * 1e3)):
            return None
        client, *parts = self.commands.recv_multipart()
        return client, parts[0] if len(parts) == 1 else b""

    def answer(self, client: bytes, message: Message) -> None:
        """Send a message to a client. The message is dropped if the client is disconnected or does not read."""
        with contextlib.suppress(zmq.ZMQError):
            self.commands.send_multipart([client, encode(message)], zmq.NOBLOCK)

    def publish(self, states: States) -> None:
        """Send states to all clients that ask for them. Only one thread may call `publish`."""
        now, message = SYSTEM.now(), encode(states)
        with contextlib.suppress(zmq.Again):
            for _ in range(_MOST_ASKED):
                self._asked_s[self.states.recv_multipart(zmq.NOBLOCK)[0]] = now
        self._asked_s = {client: asked_s for client, asked_s in self._asked_s.items() if now - asked_s < _LISTENS_S}
        for client in self._asked_s:  # without an error, a message to a client that has gone or is slow is dropped
            self.states.send_multipart([client, message], zmq.NOBLOCK)

    def close(self) -> None:
        """Close the sockets. Idempotent."""
        if self._authenticator is not None and self._authenticator.is_alive():
            self._authenticator.stop()
        self._context.destroy(linger=0)
