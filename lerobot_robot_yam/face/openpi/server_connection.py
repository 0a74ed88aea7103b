"""Connection to an openpi server: the server's greeting, then one request and reply at a time.

The server (openpi, `src/openpi/serving/websocket_policy_server.py`) sends its metadata as a greeting, then one reply to
each message. After a failure it sends a traceback as text and closes the connection. A server whose metadata list
`reset` in `endpoints` can also reset its policy, as RoboArena's servers do.
"""

import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from lerobot_robot_yam.errors import ConfigError, PolicyServerError
from lerobot_robot_yam.face.openpi.configuration_openpi import YamOpenpiConfig
from lerobot_robot_yam.face.openpi.messages import (
    ENDPOINT_KEY,
    ENDPOINTS_KEY,
    RESET,
    RESET_DONE,
    decode_message,
    encode_message,
)
from lerobot_robot_yam.system.own_commands import install_extra

try:
    from websockets.exceptions import ConnectionClosed, InvalidStatus, InvalidURI, WebSocketException
    from websockets.frames import CloseCode
    from websockets.sync.client import connect
    from websockets.sync.connection import Connection
except ImportError as error:
    raise ConfigError(
        f"policies on an openpi server need websockets, msgpack and pillow ({error}); {install_extra('openpi')}"
    ) from error

logger = logging.getLogger(__name__)

_RETRY_S = 0.25  # pause between two attempts to connect, s
_CLOSE_TIMEOUT_S = 1.0  # timeout of the closing handshake with a server, which may hang, s
_UNAUTHORISED = (401, 403)  # HTTP statuses of a refused API key
_MOST_BYTES = 16 * 2**20  # maximum size of a reply, bytes; a chunk of 1000 actions for two arms has 0.1 MiB


class ServerConnection:
    """Connection to a policy server. Not for use by several threads at once.

    Any failure closes the connection, so that a late reply is never taken for the next one. A new request reconnects.

    Args:
        config: address of the server, and timeouts.
        check: callback that gets the metadata of each greeting, and raises if they contradict the config.

    Attributes:
        metadata: metadata of the last greeting.

    Raises:
        ConfigError: the config names an API key that is not set.
    """

    def __init__(self, config: YamOpenpiConfig, check: Callable[[dict[str, Any]], None]):
        self._config, self._name, self._check = config, config.server, check
        self.metadata: dict[str, Any] = {}
        key = config.api_key()
        self._headers = {"Authorization": f"Api-Key {key}"} if key else None
        self._next_timeout_s = config.first_response_timeout_s
        self._overdue = False  # whether the running server has timed out before, so that a longer wait would not help
        self._stack = contextlib.ExitStack()
        self._connection: Connection | None = None

    def open(self) -> None:
        """Connect. Wait if the server is still starting.

        Raises:
            PolicyServerError: the server does not start, send its greeting, or accept the connection.
            ConfigError: the URL is invalid, or the metadata contradict the config.
        """
        deadline = time.monotonic() + self._config.connect_timeout_s
        logger.info("waiting for the %s", self._name)
        while True:
            try:
                return self._open()
            except PolicyServerError as error:
                if not isinstance(error.__cause__, ConnectionRefusedError) or time.monotonic() > deadline:
                    raise
            time.sleep(_RETRY_S)

    def infer(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Return the server's reply to an observation.

        Raises:
            PolicyServerError: the server failed, disconnected, or timed out.
        """
        if self._connection is None:
            self._open()
        with self._closed_on_failure():
            answer = self._exchange(encode_message(observation), self._next_timeout_s)
            if isinstance(answer, str):
                raise PolicyServerError(
                    f"the {self._name} failed on this observation and sent the following; check that image_keys, "
                    f"state_key and prompt are what its policy expects:\n{answer.strip()}"
                )
            message = self._decode(answer)
        self._next_timeout_s, self._overdue = self._config.response_timeout_s, False
        return message

    def reset(self) -> None:
        """Begin a new episode at the server, which then ignores its memory of the previous episode.

        Nothing is sent to a server whose greeting lacks this endpoint, nor without a connection, because a server's
        memory belongs to one connection.

        Raises:
            PolicyServerError: the server failed, disconnected, or timed out.
        """
        if self._connection is None or RESET not in self.metadata.get(ENDPOINTS_KEY, []):
            return
        with self._closed_on_failure():
            answer = self._exchange(encode_message({ENDPOINT_KEY: RESET}), self._next_timeout_s)
            if answer != RESET_DONE:
                raise PolicyServerError(f"the {self._name} could not begin a new episode: {answer[:500]!r}")

    def close(self) -> None:
        self._connection = None
        self._stack.close()

    def _open(self) -> None:
        try:
            connection = self._stack.enter_context(
                connect(
                    self._config.url,
                    additional_headers=self._headers,
                    compression=None,  # as in openpi's client: compressing images takes milliseconds
                    max_size=_MOST_BYTES,
                    open_timeout=self._config.connect_timeout_s,
                    close_timeout=_CLOSE_TIMEOUT_S,
                    ping_interval=None,  # the server cannot reply to pings while it computes; `_exchange` has a timeout
                )
            )
        except (InvalidURI, ValueError) as error:  # ValueError: raised by urllib for an invalid host
            raise ConfigError(f"--policy.host and --policy.port make no websocket URL: {error}") from error
        except InvalidStatus as error:
            status = error.response.status_code
            advice = (
                "check the API key (--policy.api_key_env)" if status in _UNAUTHORISED else "is it an openpi server?"
            )
            raise PolicyServerError(f"the {self._name} turned us away with HTTP status {status}; {advice}") from error
        except (OSError, WebSocketException) as error:
            raise PolicyServerError(
                f"the {self._name} cannot be reached ({_words(error)}); is it running, are --policy.host and "
                f"--policy.port right, does a firewall or proxy stand between?"
            ) from error
        with self._closed_on_failure():
            try:
                greeting = connection.recv(self._config.connect_timeout_s)
            except (TimeoutError, ConnectionClosed) as error:
                self._check_size(error)
                raise PolicyServerError(f"the {self._name} did not greet ({_words(error)}); is it one?") from error
            metadata = self._decode(greeting)
            logger.info("connected to the %s, which says of itself: %s", self._name, metadata)
            self._check(metadata)
            self.metadata = metadata
        self._connection = connection
        if not self._overdue:
            self._next_timeout_s = self._config.first_response_timeout_s

    def _exchange(self, message: bytes, timeout_s: float) -> bytes | str:
        """Send a message and return the reply. The timeout also ends a send that the server does not read."""
        connection = self._connection
        assert connection is not None
        expired = threading.Event()

        def cut() -> None:
            expired.set()
            with contextlib.suppress(OSError):
                connection.socket.shutdown(socket.SHUT_RDWR)

        timer = threading.Timer(timeout_s, cut)
        timer.daemon = True
        timer.start()
        try:
            connection.send(message)
            return connection.recv()
        except ConnectionClosed as error:
            if expired.is_set():
                self._overdue = True
                raise PolicyServerError(
                    f"the {self._name} has not answered within {timeout_s:g} s; is it overloaded, or still compiling "
                    f"(--policy.first_response_timeout_s, --policy.response_timeout_s)?"
                ) from error
            self._check_size(error)
            raise PolicyServerError(
                f"the {self._name} has closed the connection ({_words(error)}); its own log should say why"
            ) from error
        finally:
            timer.cancel()
            timer.join()

    def _check_size(self, error: Exception) -> None:
        """Raise PolicyServerError if this side closed the connection because a message was too large."""
        ours = error.sent if isinstance(error, ConnectionClosed) else None
        if ours is not None and ours.code == CloseCode.MESSAGE_TOO_BIG:
            raise PolicyServerError(
                f"the {self._name} has sent a message of more than {_MOST_BYTES / 2**20:.0f} MiB, which no chunk of "
                "actions has; is it an openpi server?"
            ) from error

    def _decode(self, data: bytes | str) -> dict[str, Any]:
        try:
            if isinstance(data, str):
                raise ValueError(f"text instead of msgpack: {data[:200]!r}")
            message = decode_message(data)
            if not isinstance(message, dict):
                raise ValueError(f"a {type(message).__name__} instead of a dictionary")
        except ValueError as error:
            raise PolicyServerError(f"the {self._name} does not speak openpi's protocol: {error}") from error
        return message

    @contextlib.contextmanager
    def _closed_on_failure(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self.close()
            raise


def _words(error: Exception) -> str:
    return str(error) or type(error).__name__
