"""viser's server behind an access gate, which checks and rate-limits requests and messages before viser sees them.

viser 1.1 has no hook for such a gate. So while viser's server starts, `websockets.asyncio.server.serve` is replaced by
a version that adds the gate. `guarded` raises an error if viser did not call that version.
"""

import asyncio
import contextlib
import functools
import logging
import threading
import time
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response
from websockets.typing import Data

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.viewer.serving.access import Access, plain_response, shield
from lerobot_robot_yam.viewer.serving.incoming import MalformedError, passes

logger = logging.getLogger(__name__)
logger.setLevel(logging.WARNING)  # at lower levels, websockets logs whole requests including the token

_MOST_BYTES = 1 << 16  # maximum message size, bytes; viser's own limit is 50 MB
_MOST_PER_S = 400  # maximum number of messages per second from one page; a drag sends 60 to 120
_MOST_PAGES = 32
_MOST_CONNECTIONS = 128  # maximum number of TCP connections; a browser opens a few short ones and one that stays
_OPENING_S, _CLOSING_S = 5.0, 1.0
_SAID_EVERY_S = 5.0
_NO_REQUEST = "opening handshake failed"  # logged for each connection that a browser opens in advance
_POLICY_VIOLATION = 1008  # WebSocket close code for a forbidden message, RFC 6455, section 7.4.1
_starting = threading.Lock()


class Seldom(logging.Filter):
    """Log filter that passes one line per `_SAID_EVERY_S`, without traceback: clients cannot flood the terminal."""

    def __init__(self) -> None:
        super().__init__()
        self._said_s, self._left_out = -_SAID_EVERY_S, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to log a record; shorten records that pass."""
        if record.msg == _NO_REQUEST:
            return False
        now_s = time.monotonic()
        if now_s - self._said_s < _SAID_EVERY_S:
            self._left_out += 1
            return False
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            text += f": {record.exc_info[1]!r:.200}"
        if self._left_out:
            text += f" (and {self._left_out} more like this)"
        record.msg, record.args, record.exc_info, record.exc_text = text, None, None, None
        self._said_s, self._left_out = now_s, 0
        return True


logger.addFilter(Seldom())


class Gate:
    """Access gate: checks incoming requests and messages, and counts pages and connections.

    `access`: decides which requests are answered.

    Attributes:
        server: viser's server. While this is None, no message may change a control.
    """

    def __init__(self, access: Access):
        self.server: viser.ViserServer | None = None
        self._access = access
        self._version = f"viser-v{viser.__version__}"
        self.pages = self.connections = 0

    def answer(self, connection: ServerConnection, request: Request, serve: Callable[..., Response | None]) -> Any:
        """Return the response to a request, or None to accept a WebSocket."""
        response = self._access.answer(request)
        if response is None and "Upgrade" in request.headers:
            offered = ",".join(request.headers.get_all("Sec-WebSocket-Protocol"))
            if self._version not in (name.strip() for name in offered.split(",")):  # viser would print a line for each
                response = plain_response(HTTPStatus.UPGRADE_REQUIRED, "this page is of another version: load it again")
            elif self.pages >= _MOST_PAGES:
                response = plain_response(HTTPStatus.SERVICE_UNAVAILABLE, f"{_MOST_PAGES} pages are open already")
            else:
                return None
        if response is None:
            try:
                response = serve(connection, request)
            except (OSError, ValueError):  # raised for an impossible file path
                response = plain_response(HTTPStatus.NOT_FOUND, "not found")
        return None if response is None else shield(request, response)

    def control(self, uuid: str) -> Any:
        """Return the handle of a control that all pages share or that belongs to one page; None if there is none."""
        if self.server is None:
            return None
        for gui in (self.server.gui, *(client.gui for client in self.server.get_clients().values())):
            handle = gui._gui_input_handle_from_uuid.get(uuid)
            if handle is not None:
                return handle
        return None


class _Connection(ServerConnection):
    """Connection that delivers only messages accepted by the gate."""

    def __init__(self, gate: Gate, *arguments: Any, **options: Any):
        super().__init__(*arguments, **options)
        self._gate = gate
        self._second, self._in_second = 0, 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._gate.connections += 1
        super().connection_made(transport)
        if self._gate.connections > _MOST_CONNECTIONS:
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._gate.connections -= 1
        super().connection_lost(exc)

    async def recv(self, decode: bool | None = None) -> Data:  # type: ignore[override]
        while True:
            raw = await super().recv(decode)
            await self._pace()
            try:
                if passes(raw, self._gate.control):
                    return raw
                logger.warning("left out what a page may not send, or not now: %.80r", raw)
            except MalformedError as error:
                logger.warning("a connection is closed: %s", error)
                await self.close(_POLICY_VIOLATION, "malformed message")

    async def _pace(self) -> None:
        """Wait for the next second if more than `_MOST_PER_S` messages came in this one; others stay in the socket."""
        now_s = time.monotonic()
        if int(now_s) != self._second:
            self._second, self._in_second = int(now_s), 0
        self._in_second += 1
        if self._in_second > _MOST_PER_S:
            await asyncio.sleep(1.0 - now_s % 1.0)


@contextlib.contextmanager
def guarded(gate: Gate) -> Iterator[None]:
    """Put the gate in front of the viser server that is started inside the `with` block.

    Raises:
        ConfigError: viser has started without the gate, because its version is incompatible.
    """
    module = websockets.asyncio.server
    asked: list[bool] = []
    with _starting:
        plain = module.serve

        def serve(handler: Callable[..., Any], *arguments: Any, process_request: Any = None, **options: Any) -> Any:
            asked.append(True)
            asyncio.get_running_loop().set_exception_handler(_complain)

            async def counted(connection: ServerConnection) -> None:
                gate.pages += 1
                try:
                    await handler(connection)
                finally:
                    gate.pages -= 1

            options |= {
                "max_size": _MOST_BYTES,
                "open_timeout": _OPENING_S,
                "close_timeout": _CLOSING_S,
                "logger": logger,
                "create_connection": functools.partial(_Connection, gate),
                "process_request": lambda connection, request: gate.answer(connection, request, process_request),
            }
            return plain(counted, *arguments, **options)

        module.serve = serve  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            module.serve = plain  # type: ignore[misc]
    if not asked:
        raise ConfigError("this version of viser cannot be guarded; install viser 1.1")


def _complain(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    logger.warning("%s: %.200r", context.get("message"), context.get("exception"))
