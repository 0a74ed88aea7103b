"""The client that Commander's page uses: every call is a coroutine; and the status that it streams.

async with AsyncRobotClient() as rbt:
    await rbt.move_j([0, 60, 60, -29, 0, 0], wait=True)
"""

import asyncio
import copy
from collections.abc import AsyncIterator, Callable
from enum import IntEnum
from typing import Any

import numpy as np
from waldoctl import ActionState, ToolSpec, ToolState, ToolStatus
from waldoctl import RobotClient as WaldoClient

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.client.motion_calls import MotionCalls
from lerobot_robot_yam.waldo.client.query_calls import QueryCalls
from lerobot_robot_yam.waldo.client.setting_calls import SettingCalls
from lerobot_robot_yam.waldo.kinematics.frames import FRAMES
from lerobot_robot_yam.waldo.tool_catalog import bound_tool
from lerobot_robot_yam.waldo.wire import MOST_BYTES, STREAM, decode, encode

_AGAIN_S = 0.2  # before the stream looks for the controller again
_VARIANT = {"variant_key": ""} if "variant_key" in getattr(ToolStatus, "__dataclass_fields__", {}) else {}
_PLAIN = (
    "action_current action_params executing_index completed_index last_checkpoint tcp_speed simulator_active "
    "collision_active scene_epoch homed enabled link_health drive_health loop_health homing freedrive session_id"
).split()


class ControllerMode(IntEnum):
    """What commands move; its name is displayed."""

    SIMULATOR = 0
    ROBOT = 1


class StatusBuffer:
    """One status. Lengths in mm, angles in deg; `speeds` in rad/s, torques in Nm, `tcp_speed` in mm/s.

    The fields are those of the contract. `tool_status` is a new object each time: the host writes into it.
    """

    def __init__(self) -> None:
        self.pose, self.angles, self.speeds = np.eye(4).reshape(16), np.zeros(6), np.zeros(6)
        self.torques: np.ndarray = np.zeros(6)
        self.torques_ext: np.ndarray | None = None  # no model of the tool's contact: not offered
        self.io, self.joint_en = np.ones(1, np.int32), np.zeros(12, np.int32)
        self.cart_en = {frame: np.zeros(12, np.int32) for frame in FRAMES}
        self.tool_status = ToolStatus()
        self.action_state = ActionState.IDLE
        self.mode = ControllerMode.SIMULATOR

    def take(self, message: dict[str, Any]) -> None:
        """Write a status as it comes over the wire."""
        for name in ("pose", "angles", "speeds", "torques", "io", "joint_en"):
            getattr(self, name)[:] = message[name]
        for frame in FRAMES:
            self.cart_en[frame][:] = message["cart_en"][frame]
        for name in _PLAIN:
            setattr(self, name, message[name])
        self.warnings = [tuple(warning) for warning in message["warnings"]]
        self.error = None if message["error"] is None else tuple(message["error"])
        self.collision_pairs = [tuple(pair) for pair in message["collision_pairs"]]
        self.action_state = ActionState(message["action_state"])
        self.mode = ControllerMode.SIMULATOR if message["simulator_active"] else ControllerMode.ROBOT
        tool = dict(message["tool"])
        tool["state"] = ToolState(tool["state"])
        tool["positions"], tool["channels"] = tuple(tool["positions"]), tuple(tool["channels"])
        self.tool_status = ToolStatus(**tool, **_VARIANT)

    def copy(self) -> "StatusBuffer":
        """A status that shares nothing with this one."""
        return copy.deepcopy(self)


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
