"""The calls of a client that change how the controller works, and the one that moves the tool."""

from collections.abc import Sequence
from typing import Any

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.client.asking import Asking

_JAW_S = 3.0  # a gripper has stopped by then


class SettingCalls(Asking):
    """Settings of a client; each raises ControllerError where the controller refuses it."""

    async def simulator(self, enabled: bool) -> int:
        """Have commands move the simulated arm, or the real one, which holds where it is. Energises nothing: the real
        arm has to be armed before, by `yam-waldo arm`.

        Category: Control

        Example:
            rbt.simulator(True)
        """
        return int(await self._ask("simulator", enabled=bool(enabled)))

    async def teleport(self, angles_deg: Sequence[float], tool_positions: Sequence[float] | None = None) -> int:
        """Put the simulated arm, and its jaws (0 open … 1 closed), somewhere at once. No real arm can be told so.

        Category: Control

        Example:
            rbt.teleport([0, 60, 60, -29, 0, 0])
        """
        return int(await self._ask("teleport", angles_deg=angles_deg, tool_positions=tool_positions))

    async def freedrive(self, enabled: bool) -> int:
        """Let a hand move the real arm, which weighs nothing to it, or have it hold where it is.

        Category: Control

        Example:
            rbt.freedrive(True)
        """
        return int(await self._ask("freedrive", enabled=bool(enabled)))

    async def connect_hardware(self, port_str: str) -> int:
        """Refused, unless it names the channel that the controller has: this choice is made at the arm's computer.

        Category: Configuration

        Example:
            rbt.connect_hardware("can_follower_l")
        """
        return int(await self._ask("connect_hardware", port_str=port_str))

    async def select_profile(self, profile: str) -> int:
        """Choose a motion profile.

        Category: Configuration

        Example:
            rbt.select_profile("jerk_limited")
        """
        return int(await self._ask("select_profile", profile=profile))

    async def select_tool(self, tool_name: str, variant_key: str = "") -> int:
        """Say which tool is on the arm: poses are its tip's from now on, without an offset.

        Category: Configuration

        Example:
            rbt.select_tool("LINEAR_4310")
        """
        return int(await self._ask("select_tool", tool_name=tool_name, variant_key=variant_key))

    async def set_tcp_offset(self, x: float = 0, y: float = 0, z: float = 0) -> int:
        """Move the tip of the tool by x y z, mm in the tool's frame.

        Category: Configuration

        Example:
            rbt.set_tcp_offset(0, 0, 10)
        """
        return int(await self._ask("set_tcp_offset", x=x, y=y, z=z))

    async def tool_action(
        self,
        tool_key: str,
        action: str,
        params: Sequence[float] | None = None,
        *,
        wait: bool = False,
        timeout: float = 10.0,
    ) -> int:
        """Have the tool `open`, `close`, or `move` to params[0], 0 open … 1 closed. It takes its turn in the queue.

        Category: I/O

        Example:
            rbt.tool_action("LINEAR_4310", "close")
        """
        index = await self._ask("tool_action", tool_key=tool_key, action=action, params=params)
        limit_s = timeout + _JAW_S
        if wait and not await self._ask("wait_command", limit_s, command_index=index, timeout=timeout):
            raise ControllerError(f"{tool_key}: {action} did not end within {timeout:g} s, or was cancelled")
        return 1

    async def reset_state(self) -> int:
        """Stop, and put tool, offset, payload and shapes back to what they were at the start. Nothing else moves.

        Category: Control

        Example:
            rbt.reset_state()
        """
        return int(await self._ask("reset_state"))

    async def set_payload(
        self, mass: float, com: Sequence[float] = (0.0, 0.0, 0.0), inertia: Sequence[float] | None = None
    ) -> int:
        """Say what the tool carries: kg, and the centre in the frame of the tool, m. `inertia` is not used.

        Category: Configuration

        Example:
            rbt.set_payload(0.2)
        """
        return int(await self._ask("set_payload", mass=mass, com=com))

    async def set_shapes(self, shapes: Sequence[dict[str, Any]]) -> int:
        """Say which boxes the arm keeps away from: name, center_m (3), size_m (3), yaw_rad, in the base frame.

        Category: Configuration

        Example:
            rbt.set_shapes([{"name": "camera", "center_m": [0.3, 0, 0.1], "size_m": [0.1, 0.1, 0.2]}])
        """
        return int(await self._ask("set_shapes", shapes=shapes))
