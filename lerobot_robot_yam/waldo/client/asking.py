"""What all calls of a client share: they ask the controller, and connect to it when that is needed."""

import asyncio
from typing import Any

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.client.connection import Connection
from lerobot_robot_yam.waldo.wire import HOST, PORT


class Asking:
    """Asks one controller. Making it opens nothing: Commander does so outside any event loop.

    Args:
        host, port: where the controller serves.
        timeout: s in which it has to answer.
    """

    def __init__(self, host: str = HOST, port: int = PORT, timeout: float = 5.0, **_: Any):
        self.host, self.port, self.timeout = host, int(port), float(timeout)
        self._connection: Connection | None = None

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

    async def _connected(self) -> Connection:
        if not self._usable:
            opened = await Connection.open(self.host, self.port)
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
