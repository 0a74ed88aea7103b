"""Base class of the clients: queries and settings, none of which moves the arm."""

import asyncio
import itertools
import secrets
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

from waldoctl import ActionState, ActivityResult, PingResult, ToolResult, ToolSpec

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.client.status_stream import StatusBuffer, StatusStream
from lerobot_robot_yam.waldo.tool_catalog import bound_tool, palette
from lerobot_robot_yam.waldo.wire import HOST, MOST_BYTES, PORT, encode, result_of


class StateClient:
    """Client for a controller's queries and settings, see `AsyncRobotClient`. Settings return 1.

    The constructor opens no connection, since Commander creates clients outside any event loop. Each call opens its own
    connection, so that calls may overlap.

    Args:
        host, port: address of the controller.
        timeout: maximum wait for a reply, s.
    """

    def __init__(self, host: str = HOST, port: int = PORT, timeout: float = 5.0, **_: Any):
        self.host, self.port, self.timeout = host, int(port), float(timeout)
        self._name, self._numbers = secrets.token_hex(8), itertools.count(1)
        self._stream = StatusStream(self.host, self.port)
        self._tool: ToolSpec | None = None

    async def _ask(self, name: str, within_s: float = 0.0, /, **arguments: Any) -> Any:
        """Send a request and return the result. The timeout is `timeout` or `within_s`, whichever is longer."""
        limit_s, address = max(self.timeout, within_s), f"{self.host}:{self.port}"
        request = {"do": name, "with": arguments, "client": self._name, "number": next(self._numbers)}
        try:
            async with asyncio.timeout(limit_s):
                reader, writer = await asyncio.open_connection(self.host, self.port, limit=MOST_BYTES)
                try:
                    writer.write(encode(request))
                    return result_of(name, await reader.readline())
                finally:
                    writer.close()
        except TimeoutError:
            raise ControllerError(f"{name}: no answer from {address} within {limit_s:g} s") from None
        except OSError as error:
            raise ControllerError(
                f"{name}: no controller on {address} ({error.strerror or error}); start it: yam-waldo"
            ) from error

    async def close(self) -> None:
        """End all status streams of this client. Idempotent."""
        self._stream.close()

    # the status

    def stream_status_shared(self) -> AsyncIterator[StatusBuffer]:
        """Return an iterator over statuses until the client is closed. The same object is updated for each status."""
        return self._stream.statuses()

    async def stream_status(self) -> AsyncIterator[StatusBuffer]:
        """Yield statuses until the client is closed, each as a separate object."""
        async for status in self._stream.statuses():
            yield status.copy()

    async def wait_status(self, predicate: Callable[[Any], bool], timeout: float = 5.0) -> bool:
        """Wait for a status that satisfies `predicate`. Return False if none arrives within `timeout` s."""
        try:
            async with asyncio.timeout(timeout):
                async for status in self._stream.statuses():
                    if predicate(status):
                        return True
        except TimeoutError:
            pass
        return False

    async def wait_ready(self, timeout: float = 5.0, interval: float = 0.05) -> bool:
        """Wait until the controller replies. Return False if it does not within `timeout` s."""
        end = asyncio.get_running_loop().time() + timeout
        while await self.ping() is None:
            if asyncio.get_running_loop().time() > end:
                return False
            await asyncio.sleep(interval)
        return True

    @palette("Query", "rbt.ping()")
    async def ping(self) -> PingResult | None:
        """Return whether the controller has a real arm that is ready to be driven; None if no controller replies."""
        try:
            return PingResult(hardware_connected=bool((await self._ask("ping"))["hardware_connected"]))
        except ControllerError:
            return None

    @palette("Query", "rbt.status()")
    async def status(self) -> dict[str, Any]:
        """Return the newest status as a dict, with the fields of the status stream."""
        return dict(await self._ask("status"))

    @palette("Query", "rbt.angles()")
    async def angles(self) -> list[float] | None:
        """Return the measured joint angles, deg; None if no controller replies."""
        try:
            return list(await self._ask("angles"))
        except ControllerError:
            return None

    @palette("Query", "rbt.pose()")
    async def pose(self, frame: str = "WRF") -> list[float]:
        """Return the tool pose, x y z rx ry rz in mm and deg (intrinsic XYZ)."""
        return list(await self._ask("pose", frame=frame))

    @palette("Query", "rbt.joint_speeds()")
    async def joint_speeds(self) -> list[float]:
        """Return the measured joint speeds, deg/s."""
        return list(await self._ask("joint_speeds"))

    @palette("Query", "rbt.tcp_speed()")
    async def tcp_speed(self) -> float:
        """Return the speed of the tool's tip, mm/s."""
        return float((await self.status())["tcp_speed"])

    @palette("Query", "rbt.io()")
    async def io(self) -> list[int]:
        """Return [1], the state of the e-stop circuit. The arm has no digital pins."""
        return list((await self.status())["io"])

    @palette("Query", "rbt.queue()")
    async def queue(self) -> list[str]:
        """Return the running command and all queued commands."""
        return list(await self._ask("queue"))

    @palette("Query", "rbt.activity()")
    async def activity(self) -> ActivityResult:
        """Return the running command and the current error."""
        now = await self.status()
        wrong = "" if now["error"] is None else now["error"][2]
        return ActivityResult(
            ActionState(now["action_state"]), now["action_current"], now["action_params"], error=wrong
        )

    @palette("Query", "rbt.error()")
    async def error(self) -> str | None:
        """Return the error that prevents the arm from moving, or None."""
        wrong = (await self.status())["error"]
        return None if wrong is None else str(wrong[2])

    @palette("Query", "rbt.reachable()")
    async def reachable(self) -> dict[str, list[int]]:
        """Return frame -> 1 for each free direction of the tool, else 0: X+ X- Y+ Y- Z+ Z- RX+ RX- RY+ RY- RZ+ RZ-."""
        return dict((await self.status())["cart_en"])

    @palette("Query", "rbt.is_simulator()")
    async def is_simulator(self) -> bool:
        """Return whether commands move the simulated arm."""
        return bool((await self._ask("ping"))["simulator"])

    @palette("Query", "rbt.is_freedrive()")
    async def is_freedrive(self) -> bool:
        """Return whether the arm can be moved by hand now."""
        return bool((await self.status())["freedrive"])

    # the tool

    @property
    def tool(self) -> ToolSpec:
        """Selected tool. Raises ControllerError (a RuntimeError): call `select_tool` or `tools` first."""
        if self._tool is None:
            raise ControllerError("no tool was selected through this client yet: call select_tool or tools")
        return self._tool

    @palette("Query", "rbt.tools()")
    async def tools(self) -> ToolResult:
        """Return the selected tool's key and the keys of all tools of the arm."""
        found = ToolResult(**await self._ask("tools"))
        self._tool = bound_tool(found.tool, self)
        return found

    @palette("Configuration", 'rbt.select_tool("LINEAR_4310")')
    async def select_tool(self, tool_name: str, variant_key: str = "") -> int:
        """Select the tool whose tip all poses refer to from now on. Resets the tip offset to zero."""
        code = int(await self._ask("select_tool", tool_name=tool_name, variant_key=variant_key))
        await self.tools()
        return code

    @palette("Configuration", "rbt.set_tcp_offset(0, 0, 10)")
    async def set_tcp_offset(self, x: float = 0, y: float = 0, z: float = 0) -> int:
        """Shift the tool's tip by x y z, mm, in the tool frame."""
        return int(await self._ask("set_tcp_offset", x=x, y=y, z=z))

    @palette("Configuration", "rbt.tcp_offset()")
    async def tcp_offset(self) -> list[float]:
        """Return the offset of the tool's tip, x y z in mm."""
        return list(await self._ask("tcp_offset"))

    # other settings

    @palette("Configuration", 'rbt.connect_hardware("can_follower_l")')
    async def connect_hardware(self, port_str: str) -> int:
        """Check that the controller uses this CAN channel. The channel itself is chosen at the arm's computer."""
        return int(await self._ask("connect_hardware", port_str=port_str))

    @palette("Configuration", 'rbt.select_profile("ruckig")')
    async def select_profile(self, profile: str) -> int:
        """Select a motion profile."""
        return int(await self._ask("select_profile", profile=profile))

    @palette("Query", "rbt.profile()")
    async def profile(self) -> str:
        """Return the selected motion profile."""
        return str(await self._ask("profile"))

    @palette("Configuration", "rbt.set_payload(0.2)")
    async def set_payload(
        self, mass: float, com: Sequence[float] = (0.0, 0.0, 0.0), inertia: Sequence[float] | None = None
    ) -> int:
        """Set the payload: mass, kg, and its centre in the tool frame, m. `inertia` is ignored."""
        return int(await self._ask("set_payload", mass=mass, com=com))

    @palette("Query", "rbt.payload()")
    async def payload(self) -> dict[str, Any]:
        """Return the payload: mass (kg) and com (m)."""
        return dict(await self._ask("payload"))

    @palette("Configuration", 'rbt.set_shapes([{"name": "box", "center_m": [0.4, 0, 0.1], "size_m": [0.1, 0.1, 0.2]}])')
    async def set_shapes(self, shapes: Sequence[dict[str, Any]]) -> int:
        """Set the boxes that the arm avoids: name, center_m (3), size_m (3), yaw_rad, in the base frame."""
        return int(await self._ask("set_shapes", shapes=shapes))

    @palette("Query", "rbt.shapes()")
    async def shapes(self) -> list[dict[str, Any]]:
        """Return the boxes that the arm avoids."""
        return list(await self._ask("shapes"))
