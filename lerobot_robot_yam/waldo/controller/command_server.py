"""Server of the controller: answers clients' requests over TCP, streams statuses, and serves the operator."""

import asyncio
import contextlib
import functools
import inspect
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ControllerError, YamError
from lerobot_robot_yam.waldo.controller.client_requests import MotionRequests, SettingRequests
from lerobot_robot_yam.waldo.controller.controller import TICK_S, Controller
from lerobot_robot_yam.waldo.controller.status_report import STATUS_HZ, StatusReport
from lerobot_robot_yam.waldo.wire import MOST_BYTES, STREAM, decode, door_path, encode

_BEHIND_BYTES = 1 << 16  # unread status bytes above which a client gets no further status until it reads
_REQUESTS = {
    Controller: "stop estop reset simulator freedrive teleport",
    MotionRequests: (
        "move_j move_l home servo_j servo_l jog_j jog_l delay checkpoint tool_action "
        "wait_command wait_checkpoint wait_motion"
    ),
    SettingRequests: (
        "tools select_tool set_tcp_offset tcp_offset select_profile profile connect_hardware "
        "set_payload payload set_shapes shapes reset_state"
    ),
    StatusReport: "ping angles joint_speeds pose queue status",
}
"""Clients' requests. Arming and landing are reserved for the operator."""

_STOPS = ("stop", "estop")
_MOST_CLIENTS = 64  # maximum number of clients whose last stop is remembered

Requests = Mapping[str, Callable[..., Any]]

logger = logging.getLogger(__name__)


class CommandServer:
    """Server of a controller: clients' requests and statuses over TCP, and the operator's requests.

    `operator`: the operator's requests, served on the socket `wire.door_path`; None: the socket is not opened.
    """

    def __init__(self, controller: Controller, operator: Requests | None = None):
        self.controller = controller
        self.motions = MotionRequests(controller)
        settings = SettingRequests(controller, self.motions)
        self.report = StatusReport(controller, settings)
        parts = {type(part): part for part in (controller, self.motions, settings, self.report)}
        self._requests: Requests = {
            name: getattr(parts[kind], name) for kind, names in _REQUESTS.items() for name in names.split()
        }
        acts = f"{_REQUESTS[Controller]} {_REQUESTS[MotionRequests]}".split()
        self._acts = {name for name in acts if name not in _STOPS and not name.startswith("wait_")}
        self._stopped: dict[str, int] = {}  # client -> number of its last stop
        self._subscribers: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._operator = operator
        self._door: Path | None = None
        self._servers: list[asyncio.Server] = []

    async def open(self, host: str, port: int) -> None:
        """Start serving. Raises ControllerError: the port is in use, or the address is not this computer's."""
        try:
            serve = functools.partial(self._serve, self._requests)
            self._servers.append(await asyncio.start_server(serve, host, port, limit=MOST_BYTES))
        except OSError as error:
            raise ControllerError(f"{host}:{port} cannot be served ({error.strerror}); is it taken?") from error
        if self._operator is not None:
            self._door = door_path(port)
            self._door.unlink(missing_ok=True)  # left by a dead controller, since we own the port
            serve = functools.partial(self._serve, self._operator)
            self._servers.append(await asyncio.start_unix_server(serve, self._door))
            self._door.chmod(0o600)
        for work in (self._tick_on(), self._send_on(), self.report.probe_on()):
            self._keep(asyncio.create_task(work))

    async def close(self) -> None:
        """Stop serving. The arm keeps its state; use `Controller.land` to land it."""
        for server in self._servers:
            server.close()
        if self._door is not None:
            self._door.unlink(missing_ok=True)
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for writer in tuple(self._subscribers):
            writer.close()
        self.motions.close()

    async def request(self, name: str, /, **arguments: Any) -> Any:
        """Execute a client's request and return its result. Raises YamError: the request is refused."""
        return await self._result(self._requests, name, arguments)

    async def _result(self, requests: Requests, name: str, arguments: dict[str, Any]) -> Any:
        request = requests.get(name)
        if request is None:
            raise ControllerError(f"the controller knows no request {name!r}")
        try:
            inspect.signature(request).bind(**arguments)
            result = request(**arguments)
            return await result if inspect.isawaitable(result) else result
        except (TypeError, ValueError) as error:
            logger.debug("%s was refused", name, exc_info=True)
            raise ControllerError(f"{name}: wrong arguments ({error})") from error

    def _keep(self, task: asyncio.Task[None]) -> None:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _tick_on(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            try:
                self.controller.tick()
            except Exception as error:  # a defect in our code: the arm's own loop holds when targets cease
                if not self.controller.fault:
                    logger.exception("a tick of the controller failed")
                    self.controller.fail(f"the controller has a defect ({error}); see its log")
            self.report.ticked()
            due_s = max(due_s + TICK_S, loop.time())  # after a delay, missed ticks are skipped
            await asyncio.sleep(due_s - loop.time())

    async def _send_on(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            self.broadcast()
            due_s = max(due_s + 1.0 / STATUS_HZ, loop.time())
            await asyncio.sleep(due_s - loop.time())

    def broadcast(self) -> None:
        """Send the current status to all subscribers, except to those that do not read."""
        if not self._subscribers:
            return
        line = encode(self.report.status())
        for writer in tuple(self._subscribers):
            if writer.transport.get_write_buffer_size() < _BEHIND_BYTES:
                writer.write(line)

    async def _serve(self, requests: Requests, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._keep(task)
        try:
            message = decode(await reader.readline())
            if requests is self._requests and message.get("do") == STREAM:
                self._subscribers.add(writer)
                await reader.read(1)  # returns when the client disconnects
            else:
                writer.write(encode(await self._answer(requests, message)))
                await writer.drain()
        except (OSError, ValueError) as error:  # the client has disconnected, or its request is not JSON
            logger.debug("a client is gone: %s", error)
        except asyncio.CancelledError:  # raised when the server closes; Python would log an error
            pass
        finally:
            self._subscribers.discard(writer)
            with contextlib.suppress(OSError):
                writer.close()

    def _refuse_overtaken(self, name: str, client: object, number: object) -> None:
        """Raise ControllerError if a later stop from the same client has arrived before this request."""
        if not (isinstance(client, str) and isinstance(number, int)):
            return
        newest = self._stopped.get(client, 0)
        if name in _STOPS:
            self._stopped.pop(client, None)  # moves the client to the end of the dict, to be forgotten last
            self._stopped[client] = max(newest, number)
            if len(self._stopped) > _MOST_CLIENTS:
                del self._stopped[next(iter(self._stopped))]
        elif name in self._acts and number < newest:
            raise ControllerError(f"{name}: a stop that was sent after it has overtaken it; it does nothing")

    async def _answer(self, requests: Requests, message: dict[str, Any]) -> dict[str, Any]:
        name = str(message.get("do"))
        try:
            if requests is self._requests:
                self._refuse_overtaken(name, message.get("client"), message.get("number"))
            return {"result": await self._result(requests, name, dict(message.get("with", {})))}
        except YamError as error:
            return {"refused": str(error)}
        except Exception as error:  # a defect in our code: the client still needs a reply
            logger.exception("%s failed", name)
            return {"refused": f"{name} failed ({type(error).__name__}); see the log of the controller"}
