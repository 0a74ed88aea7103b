"""One client's line to the controller: requests go out, answers come back by their number."""

import asyncio
import itertools
from typing import Any

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.wire import MOST_BYTES, decode, encode


class Connection:
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
    async def open(cls, host: str, port: int) -> "Connection":
        """Connect. Raises OSError: nobody serves there."""
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
