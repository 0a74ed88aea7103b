"""Controller statuses in Commander's form, and a reconnecting stream of them."""

import asyncio
import copy
from collections.abc import AsyncIterator
from enum import IntEnum
from typing import Any

import numpy as np
from waldoctl import ActionState, ToolState, ToolStatus

from lerobot_robot_yam.waldo.poses import FRAMES
from lerobot_robot_yam.waldo.wire import MOST_BYTES, STREAM, decode, encode

_AGAIN_S = 0.2  # delay before reconnecting, s
_VARIANT = {"variant_key": ""} if "variant_key" in getattr(ToolStatus, "__dataclass_fields__", {}) else {}


class ControllerMode(IntEnum):
    """Arm that commands move. Commander displays the member's name."""

    SIMULATOR = 0
    ROBOT = 1


class StatusBuffer:
    """Status of the controller. Lengths in mm, angles in deg; `speeds` in rad/s, torques in Nm, `tcp_speed` in mm/s.

    The fields are defined by Commander's contract. Each status gets a new `tool_status`, since Commander modifies it.
    """

    def __init__(self) -> None:
        self.pose, self.angles, self.speeds = np.eye(4).reshape(16), np.zeros(6), np.zeros(6)
        self.torques: np.ndarray = np.zeros(6)
        self.torques_ext: np.ndarray | None = None  # external torques: None, contacts are not modelled
        self.io, self.joint_en = np.ones(1, np.int32), np.zeros(12, np.int32)
        self.cart_en = {frame: np.zeros(12, np.int32) for frame in FRAMES}
        self.tool_status = ToolStatus()
        self.action_state = ActionState.IDLE
        self.mode = ControllerMode.SIMULATOR

    def write(self, message: dict[str, Any]) -> None:
        """Copy the fields of a decoded status message into this object."""
        for name, value in message.items():
            held = getattr(self, name, None)
            if isinstance(held, np.ndarray):
                held[:] = value
            elif name not in ("tool", "cart_en"):
                setattr(self, name, value)
        for frame in FRAMES:
            self.cart_en[frame][:] = message["cart_en"][frame]
        self.warnings = [tuple(warning) for warning in message["warnings"]]
        self.error = None if message["error"] is None else tuple(message["error"])
        self.action_state = ActionState(message["action_state"])
        self.mode = ControllerMode.SIMULATOR if message["simulator_active"] else ControllerMode.ROBOT
        tool = dict(message["tool"])
        tool["state"] = ToolState(tool["state"])
        tool["positions"], tool["channels"] = tuple(tool["positions"]), tuple(tool["channels"])
        self.tool_status = ToolStatus(**tool, **_VARIANT)

    def copy(self) -> "StatusBuffer":
        """Return a deep copy of this status."""
        return copy.deepcopy(self)


class StatusStream:
    """Stream of statuses from the controller at an address. It reconnects when the controller is restarted."""

    def __init__(self, host: str, port: int):
        self._address = host, port
        self._open: set[asyncio.StreamWriter] = set()
        self._closed = False

    async def statuses(self) -> AsyncIterator[StatusBuffer]:
        """Yield statuses until the stream is closed. The same object is updated and yielded each time."""
        status = StatusBuffer()
        while not self._closed:
            try:
                reader, writer = await asyncio.open_connection(*self._address, limit=MOST_BYTES)
            except OSError:
                await asyncio.sleep(_AGAIN_S)
                continue
            self._open.add(writer)
            try:
                writer.write(encode({"do": STREAM, "with": {}}))
                while line := await reader.readline():
                    status.write(decode(line))
                    yield status
            except ConnectionError:
                pass
            finally:
                self._open.discard(writer)
                writer.close()

    def close(self) -> None:
        """End the stream for all readers. Idempotent."""
        self._closed = True
        for writer in tuple(self._open):
            writer.close()
