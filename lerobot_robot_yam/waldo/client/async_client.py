"""The client that Commander's page uses: every call is a coroutine.

async with AsyncRobotClient() as rbt:
    await rbt.move_j([0, 60, 60, -29, 0, 0], wait=True)
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

from waldoctl import RobotClient as WaldoClient
from waldoctl import ToolSpec

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.client.motion_calls import MotionCalls
from lerobot_robot_yam.waldo.client.query_calls import QueryCalls
from lerobot_robot_yam.waldo.client.setting_calls import SettingCalls
from lerobot_robot_yam.waldo.client.status_buffer import StatusBuffer
from lerobot_robot_yam.waldo.tool_catalog import bound_tool
from lerobot_robot_yam.waldo.wire import MOST_BYTES, STREAM, decode, encode

_AGAIN_S = 0.2  # before the stream looks for the controller again


class AsyncRobotClient(MotionCalls, QueryCalls, SettingCalls, WaldoClient):
    """A client of the controller. Lengths in mm, angles in degrees, times in s; gripper 0 open … 1 closed.

    Args:
        host, port: where the controller serves.
        timeout: s in which it has to answer.

    Every call raises ControllerError where the controller refuses it, with the reason, or does not answer.
    """

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self._tool: ToolSpec | None = None
        self._streams: set[asyncio.StreamWriter] = set()
        self._closed = False

    @property
    def tool(self) -> ToolSpec:
        """The selected tool. Raises RuntimeError: none was selected through this client yet."""
        if self._tool is None:
            raise ControllerError("no tool was selected through this client yet: call select_tool or tools")
        return self._tool

    async def select_tool(self, tool_name: str, variant_key: str = "") -> int:
        code = await super().select_tool(tool_name, variant_key)
        await self.tools()
        return code

    select_tool.__doc__ = SettingCalls.select_tool.__doc__

    async def tools(self) -> Any:
        found = await super().tools()
        self._tool = bound_tool(found.tool, self)
        return found

    tools.__doc__ = QueryCalls.tools.__doc__

    async def wait_status(self, predicate: Callable[[Any], bool], timeout: float = 5.0) -> bool:
        """Wait for a status of which `predicate` is true. False: none within `timeout` s."""
        try:
            async with asyncio.timeout(timeout):
                async for status in self.stream_status_shared():
                    if predicate(status):
                        return True
        except TimeoutError:
            pass
        return False

    async def stream_status(self) -> AsyncIterator[StatusBuffer]:
        """Statuses, each an object of its own, until the client is closed."""
        async for status in self.stream_status_shared():
            yield status.copy()

    async def stream_status_shared(self) -> AsyncIterator[StatusBuffer]:
        """Statuses in one object that is written anew for each, until the client is closed."""
        status = StatusBuffer()
        while not self._closed:
            try:
                reader, writer = await asyncio.open_connection(self.host, self.port, limit=MOST_BYTES)
            except OSError:
                await asyncio.sleep(_AGAIN_S)
                continue
            self._streams.add(writer)
            try:
                writer.write(encode({"id": 0, "do": STREAM, "with": {}}))
                while line := await reader.readline():
                    status.take(decode(line))
                    yield status
            except ConnectionError:
                pass
            finally:
                self._streams.discard(writer)
                writer.close()

    async def close(self) -> None:
        """End the streams and hang up. Idempotent."""
        self._closed = True
        for writer in tuple(self._streams):
            writer.close()
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    async def __aenter__(self) -> "AsyncRobotClient":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()
