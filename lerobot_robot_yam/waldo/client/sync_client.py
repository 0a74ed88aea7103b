"""Client for scripts, with the calls of the asynchronous client. Each call blocks until its reply arrives.

from lerobot_robot_yam import RobotClient

with RobotClient() as rbt:
    rbt.move_j([0, 60, 60, -29, 0, 0], wait=True)
"""

import asyncio
import functools
import inspect
import threading
from collections.abc import Callable, Coroutine
from typing import Any

from lerobot_robot_yam.waldo.client.async_client import AsyncRobotClient


class RobotClient:
    """Client of the controller with blocking versions of the calls in `AsyncRobotClient`.

    Each call runs this client's own event loop. Inside a running event loop, use the asynchronous client instead.
    """

    def __init__(self, *args: Any, **kwargs: Any):
        self._client = AsyncRobotClient(*args, **kwargs)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lock = threading.Lock()  # held during a call: only one thread may run the loop

    def _run(self, call: Coroutine[Any, Any, Any]) -> Any:
        with self._lock:
            if self._loop is None:
                self._loop = asyncio.new_event_loop()
            return self._loop.run_until_complete(call)

    @property
    def tool(self) -> "BlockingTool":
        """Selected tool. Raises ControllerError: no controller replies."""
        if self._client._tool is None:
            self._run(self._client.tools())
        return BlockingTool(self._client.tool, self._run)

    def close(self) -> None:
        """Close the connections. Idempotent."""
        if self._loop is not None and not self._loop.is_closed():
            self._run(self._client.close())
            self._run(asyncio.sleep(0))  # closed transports are released in the next loop iteration
            self._loop.close()

    def __enter__(self) -> "RobotClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class BlockingTool:
    """Tool with blocking actions and all other attributes of the wrapped tool.

    `tool`: bound tool to wrap; `run`: function that runs a coroutine to completion.
    """

    def __init__(self, tool: Any, run: Callable[[Coroutine[Any, Any, Any]], Any]):
        self._tool, self._run = tool, run

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._tool, name)
        if not inspect.iscoroutinefunction(found):
            return found

        @functools.wraps(found)
        def blocking(*args: Any, **kwargs: Any) -> Any:
            return self._run(found(*args, **kwargs))

        return blocking


def _blocking(method: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(method)
    def call(self: RobotClient, *args: Any, **kwargs: Any) -> Any:
        return self._run(method(self._client, *args, **kwargs))

    return call


for _name, _method in inspect.getmembers(AsyncRobotClient, inspect.iscoroutinefunction):
    if not _name.startswith("_") and _name != "close":
        setattr(RobotClient, _name, _blocking(_method))
