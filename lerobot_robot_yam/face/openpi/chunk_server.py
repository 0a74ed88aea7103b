"""The server of openpi's protocol: connections, one question at a time, and an error to whoever sends anything else.

As openpi's own (`src/openpi/serving/websocket_policy_server.py`), it greets with its metadata, answers each message
with one, and after a failure sends a text and closes. It also takes RoboArena's `endpoint`: `infer` or `reset`.

Messages are decoded without pickle. They, their queue and the number of clients are bounded. The policy is not touched
by a message that it cannot answer.
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
_wire_logger.setLevel(logging.CRITICAL)  # below that, websockets tells whole requests, and tracebacks of port scans

_MOST_BYTES = 32 * 2**20  # of a message: five pictures of 1920 x 1080 pixels
_MOST_WORDS = 2000  # characters of an error, which can quote what a client sends
_MOST_CLIENTS = 8
_CLOSE_TIMEOUT_S = 1.0  # for the goodbye of a client that may be stuck
_SEND_TIMEOUT = struct.pack("ll", 5, 0)  # s, us: for a client that asks and does not read


class ChunkServer:
    """Serves a policy. Ready for clients as soon as it is made; `serve_forever` lets them in.

    Args:
        policy: what answers. Several clients can ask it; whoever did not ask last begins a new episode.
        host, port: where to listen; port 0 takes a free one.
        api_key: turns clients away that do not send it, as openpi's do (`Authorization: Api-Key …`).

    Attributes:
        port: where it listens.

    Raises:
        ConfigError: nobody can listen there.
    """

    def __init__(self, policy: ServedPolicy, host: str = "127.0.0.1", port: int = 8000, api_key: str | None = None):
        self._policy, self._api_key = policy, api_key
        self._greeting = encode_message(policy.metadata)
        self._asking = threading.Lock()
        self._asked_by: Any = None  # the connection whose episode the policy is in
        self._guard = threading.Lock()
        self._open: dict[ServerConnection, threading.Thread] = {}
        self._ending = False
        try:
            self._server = serve(
                self._serve,
                host,
                port,
                origins=[None],  # no web page of a browser on this computer
                compression=None,  # as openpi's: images would cost milliseconds
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
        """Let clients in until `close` is called from another thread, or this one is interrupted."""
        self._server.serve_forever()

    def close(self) -> None:
        """Send all clients away, and let nobody in. Waits for an answer that is being computed. Idempotent."""
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
        """What to send to a client, and whether it is an error."""
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
        """The policy in an episode of this connection; after a failure there is none."""
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
    except Exception as error:  # NumPy has many for a type or a shape that it cannot make
        raise ObservationError(f"this is no message of openpi's protocol: {error}") from error
    if not isinstance(message, dict):
        raise ObservationError(f"a message of openpi's protocol is a dictionary, not {type(message).__name__}")
    return message


def _printable(error: Exception) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in str(error)[:_MOST_WORDS])


def _name(connection: ServerConnection) -> str:
    host, port = connection.remote_address[:2]
    return f"{host}:{port}"
