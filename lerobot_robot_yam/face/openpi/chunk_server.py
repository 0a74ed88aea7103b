"""Server for openpi's protocol. Handles one request at a time; any other message gets an error.

Like openpi's own server (`src/openpi/serving/websocket_policy_server.py`), this server first sends its metadata as a
greeting, then one reply to each message. After a failure it sends a text and closes the connection. A message may have
RoboArena's field `endpoint`, with the value `infer` or `reset`.

Messages are decoded without pickle. Their size, their queue and the number of clients are limited. A message that does
not fit the policy is refused before it reaches the policy.
"""

import contextlib
import hmac
import logging
import socket
import struct
import threading
import time
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any

from lerobot_robot_yam.errors import ConfigError, ObservationError
from lerobot_robot_yam.face.openpi.messages import (
    ENDPOINT_KEY,
    INFER,
    RESET,
    RESET_DONE,
    decode_message,
    encode_message,
)
from lerobot_robot_yam.face.openpi.served_policy import ServedPolicy
from lerobot_robot_yam.system.own_commands import install_extra

try:
    from websockets.exceptions import ConnectionClosed
    from websockets.frames import CloseCode
    from websockets.http11 import Request, Response
    from websockets.sync.server import ServerConnection, serve
except ImportError as error:
    raise ConfigError(f"yam-policy-server needs websockets, too ({error}); {install_extra('openpi')}") from error

logger = logging.getLogger(__name__)
_wire_logger = logging.getLogger(f"{__name__}.wire")
_wire_logger.setLevel(logging.CRITICAL)  # at lower levels, websockets logs whole requests and port scans

_MOST_BYTES = 32 * 2**20  # maximum size of a message, bytes: five pictures of 1920 x 1080 pixels
_MOST_WORDS = 2000  # maximum length of an error, characters: an error can quote a client's message
_MOST_CLIENTS = 8  # maximum number of clients at the same time
_CLOSE_TIMEOUT_S = 1.0  # timeout of the closing handshake with a client, which may hang, s
_SEND_TIMEOUT = struct.pack("ll", 5, 0)  # (s, µs) timeout of a send to a client that does not read


class ChunkServer:
    """Server of a policy. Clients can connect once the server is created; `serve_forever` accepts them.

    Args:
        policy: the policy. Several clients can share it; when the client changes, a new episode begins.
        host, port: address to listen on; port 0 chooses a free port.
        api_key: key that clients have to send, as openpi's clients do (`Authorization: Api-Key …`); None: no key.

    Attributes:
        port: the port in use.

    Raises:
        ConfigError: the address cannot be used.
    """

    def __init__(self, policy: ServedPolicy, host: str = "127.0.0.1", port: int = 8000, api_key: str | None = None):
        self._policy, self._api_key = policy, api_key
        self._greeting = encode_message(policy.metadata)
        self._asking = threading.Lock()
        self._asked_by: Any = None  # connection that owns the policy's current episode
        self._guard = threading.Lock()
        self._open: dict[ServerConnection, threading.Thread] = {}
        self._ending = False
        try:
            self._server = serve(
                self._serve,
                host,
                port,
                origins=[None],  # refuses web pages in a browser on this computer
                compression=None,  # as in openpi's server: compressing images takes milliseconds
                process_request=self._turn_away,
                max_size=_MOST_BYTES,
                max_queue=1,
                close_timeout=_CLOSE_TIMEOUT_S,
                logger=_wire_logger,
            )
        except (OSError, OverflowError) as error:
            raise ConfigError(f"nobody can listen on {host} port {port}: {error}") from error
        self.port: int = self._server.socket.getsockname()[1]

    def serve_forever(self) -> None:
        """Accept clients until `close` is called from another thread, or this thread is interrupted."""
        self._server.serve_forever()

    def close(self) -> None:
        """Disconnect all clients, refuse new ones, and wait for a reply that is being computed. Idempotent."""
        with self._guard:
            if self._ending:
                return
            self._ending, leaving = True, dict(self._open)
        self._server.shutdown()
        for connection in leaving:
            connection.close(CloseCode.GOING_AWAY, "the server ends")
        for thread in leaving.values():
            thread.join()

    def _turn_away(self, connection: ServerConnection, request: Request) -> Response | None:
        given = request.headers.get("Authorization", "").encode(errors="surrogateescape")
        if self._api_key is None or hmac.compare_digest(given, f"Api-Key {self._api_key}".encode()):
            return None
        logger.warning("%s has no valid API key", _name(connection))
        return connection.respond(HTTPStatus.UNAUTHORIZED, "no valid API key\n")

    def _serve(self, connection: ServerConnection) -> None:
        name, answers, begun_s, busy_s = _name(connection), 0, time.monotonic(), 0.0
        with self._guard:
            refused = self._ending or len(self._open) >= _MOST_CLIENTS
            if not refused:
                self._open[connection] = threading.current_thread()
        if refused:
            connection.close(CloseCode.TRY_AGAIN_LATER, f"there are {_MOST_CLIENTS} clients already")
            return
        logger.info("%s is connected", name)
        connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _SEND_TIMEOUT)
        try:
            connection.send(self._greeting)
            for data in connection:
                asked_s = time.monotonic()
                answer, failed = self._answer(connection, name, data)
                connection.send(answer)
                if failed:
                    connection.close(CloseCode.INTERNAL_ERROR, "see the message before")
                    break
                answers, busy_s = answers + 1, busy_s + time.monotonic() - asked_s
        except ConnectionClosed:
            pass
        finally:
            with self._guard:
                del self._open[connection]
            each_ms = 1000.0 * busy_s / max(answers, 1)
            told = "%s has gone after %d answers in %.1f s, which took %.1f ms each"
            logger.info(told, name, answers, time.monotonic() - begun_s, each_ms)

    def _answer(self, connection: ServerConnection, name: str, data: bytes | str) -> tuple[bytes | str, bool]:
        """Return the reply to a client, and whether it is an error."""
        try:
            return self._answered(connection, data), False
        except ObservationError as error:
            told = _printable(error)
            logger.warning("%s was refused: %s", name, told)
            return f"yam-policy-server: {told}", True
        except Exception as error:
            logger.exception("the policy failed on a message of %s", name)
            return f"yam-policy-server: the policy failed: {type(error).__name__}: {_printable(error)}", True

    def _answered(self, connection: ServerConnection, data: bytes | str) -> bytes | str:
        message = _message(data)
        endpoint = message.get(ENDPOINT_KEY, INFER)
        if not isinstance(endpoint, str) or endpoint not in (INFER, RESET):
            raise ObservationError(f"the endpoint is {endpoint!r:.100}; there are only {INFER!r} and {RESET!r}")
        question = self._policy.question(message) if endpoint == INFER else None
        with self._asking, self._episode_of(connection, anew=question is None):
            if question is None:
                return RESET_DONE
            begun_s = time.perf_counter()
            actions = self._policy.actions(*question)
            infer_ms = (time.perf_counter() - begun_s) * 1000.0
        return encode_message({"actions": actions, "server_timing": {"infer_ms": infer_ms}})

    @contextlib.contextmanager
    def _episode_of(self, connection: ServerConnection, anew: bool) -> Iterator[None]:
        """Run a block in an episode of this connection. An error in the block ends the episode."""
        asked_by, self._asked_by = self._asked_by, None
        if anew or asked_by != connection.id:
            self._policy.reset()
        yield
        self._asked_by = connection.id


def _message(data: bytes | str) -> dict[Any, Any]:
    if isinstance(data, str):
        raise ObservationError("a message of openpi's protocol is a dictionary, not text")
    try:
        message = decode_message(data)
    except Exception as error:  # NumPy raises many kinds of errors for invalid types and shapes
        raise ObservationError(f"this is no message of openpi's protocol: {error}") from error
    if not isinstance(message, dict):
        raise ObservationError(f"a message of openpi's protocol is a dictionary, not {type(message).__name__}")
    return message


def _printable(error: Exception) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in str(error)[:_MOST_WORDS])


def _name(connection: ServerConnection) -> str:
    host, port = connection.remote_address[:2]
    return f"{host}:{port}"
