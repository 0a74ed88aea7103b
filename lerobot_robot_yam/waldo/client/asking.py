"""How a client asks the controller: over one connection, which is opened when it is needed.

Requests go out, and answers come back by their number.
"""

import asyncio
import itertools
from typing import Any

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.wire import HOST, MOST_BYTES, PORT, decode, encode


class Asking:
    """Asks one controller. Making it opens nothing: Commander does so outside any event loop.

    Args:
        host, port: where the controller serves.
        timeout: s in which it has to answer.
    """

    def __init__(self, host: str = HOST, port: int = PORT, timeout: float = 5.0, **_: Any):
        self.host, self.port, self.timeout = host, int(port), float(timeout)
        self._connection: _Connection | None = None

    async def _ask(self, name: str, within_s: float | None = None, /, **arguments: Any) -> Any:
        """The controller's answer, within the client's time-out, or `within_s` if it is longer.

        Raises:
            ControllerError: it refused, or does not answer.
        """
        limit_s = max(self.timeout, within_s or 0.0)
        try:
            async with asyncio.timeout(limit_s):
                return await (await self._connected()).ask(name, arguments)
        except TimeoutError:
            raise ControllerError(f"{name}: no answer from {self._address} within {limit_s:g} s") from None
        except OSError as error:
            raise ControllerError(
                f"{name}: no controller on {self._address} ({error.strerror or error}); start it: yam-waldo"
            ) from error

    async def _connected(self) -> "_Connection":
        if not self._usable:
            opened = await _Connection.open(self.host, self.port)
            if self._usable:  # another call was quicker
                opened.close()
            else:
                self._connection = opened
        assert self._connection is not None
        return self._connection

    @property
    def _usable(self) -> bool:
        connection = self._connection
        return connection is not None and connection.alive and connection.loop is asyncio.get_running_loop()

    @property
    def _address(self) -> str:
        return f"{self.host}:{self.port}"

    async def _then_wait(self, index: int, wait: bool, timeout: float) -> int:
        """The index of a command, after it has ended if that is wanted. Raises ControllerError: it did not."""
        if wait and not await self._ask("wait_command", timeout + 1.0, command_index=index, timeout=timeout):
            raise ControllerError(f"command {index} did not end within {timeout:g} s, or was cancelled")
        return index


class _Connection:
    """An open connection. It belongs to the event loop in which it was opened.

    Attributes:
        loop: that loop.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter):
        self.loop = asyncio.get_running_loop()
        self._reader, self._writer = reader, writer
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._listening = self.loop.create_task(self._listen())

    @classmethod
    async def open(cls, host: str, port: int) -> "_Connection":
        """Raises OSError: nobody serves there."""
        return cls(*await asyncio.open_connection(host, port, limit=MOST_BYTES))

    @property
    def alive(self) -> bool:
        """Whether the controller is there still."""
        return not self._listening.done()

    async def ask(self, name: str, arguments: dict[str, Any]) -> Any:
        """The result of a request.

        Raises:
            ControllerError: the controller refused it, or has gone.
        """
        number = next(self._numbers)
        answer = self._waiting[number] = self.loop.create_future()
        try:
            self._writer.write(encode({"id": number, "do": name, "with": arguments}))
            await self._writer.drain()
            message = await answer
        except ConnectionError as error:
            raise ControllerError(f"{name}: the controller has gone ({error})") from error
        finally:
            self._waiting.pop(number, None)
        if "refused" in message:
            raise ControllerError(message["refused"])
        return message.get("result")

    def close(self) -> None:
        """Hang up. Idempotent."""
        self._writer.close()
        self._listening.cancel()
        self._give_up()

    async def _listen(self) -> None:
        try:
            while line := await self._reader.readline():
                message = decode(line)
                answer = self._waiting.get(message["id"])
                if answer is not None and not answer.done():
                    answer.set_result(message)
        except (OSError, ValueError):
            pass  # as if it had hung up
        finally:
            self._give_up()

    def _give_up(self) -> None:
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(ConnectionResetError("the connection is closed"))
