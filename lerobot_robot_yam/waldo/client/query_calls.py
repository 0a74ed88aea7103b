"""The calls of a client that ask how the arm is. Lengths in mm, angles in degrees."""

import asyncio
from typing import Any

from waldoctl import ActionState, ActivityResult, PingResult, ToolResult

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.client.asking import Asking


class QueryCalls(Asking):
    """Queries of a client; nothing moves, and each raises ControllerError if nobody answers, unless it says else."""

    async def ping(self) -> PingResult | None:
        """Whether the controller is there (None: it is not), and whether it holds a real arm that may be driven.

        Category: Query

        Example:
            rbt.ping()
        """
        try:
            return PingResult(hardware_connected=bool((await self._ask("ping"))["hardware_connected"]))
        except ControllerError:
            return None

    async def wait_ready(self, timeout: float = 5.0, interval: float = 0.05) -> bool:
        """Wait until the controller answers. False: not within `timeout` s."""
        end = asyncio.get_running_loop().time() + timeout
        while await self.ping() is None:
            if asyncio.get_running_loop().time() > end:
                return False
            await asyncio.sleep(interval)
        return True

    async def angles(self) -> list[float] | None:
        """The measured joint angles, deg; None: nobody answers.

        Category: Query

        Example:
            rbt.angles()
        """
        try:
            return list(await self._ask("angles"))
        except ControllerError:
            return None

    async def pose(self, frame: str = "WRF") -> list[float]:
        """The pose of the tool, x y z rx ry rz in mm and deg (intrinsic XYZ).

        Category: Query

        Example:
            rbt.pose()
        """
        return list(await self._ask("pose", frame=frame))

    async def status(self) -> dict[str, Any]:
        """All that is known, as the status stream says it.

        Category: Query

        Example:
            rbt.status()
        """
        return dict(await self._ask("status"))

    async def joint_speeds(self) -> list[float]:
        """The measured speeds of the joints, deg/s.

        Category: Query

        Example:
            rbt.joint_speeds()
        """
        return list(await self._ask("joint_speeds"))

    async def tcp_speed(self) -> float:
        """The speed of the tool, mm/s.

        Category: Query

        Example:
            rbt.tcp_speed()
        """
        return float((await self._ask("status"))["tcp_speed"])

    async def io(self) -> list[int]:
        """The digital pins, of which there are none, and 1 for the circuit of the e-stop.

        Category: Query

        Example:
            rbt.io()
        """
        return list((await self._ask("status"))["io"])

    async def queue(self) -> list[str]:
        """The commands that run or wait.

        Category: Query

        Example:
            rbt.queue()
        """
        return list(await self._ask("queue"))

    async def activity(self) -> ActivityResult:
        """What runs now, and what is wrong.

        Category: Query

        Example:
            rbt.activity()
        """
        now = await self._ask("status")
        wrong = "" if now["error"] is None else now["error"][2]
        return ActivityResult(
            ActionState(now["action_state"]), now["action_current"], now["action_params"], error=wrong
        )

    async def error(self) -> str | None:
        """What keeps the arm from moving; None: nothing.

        Category: Query

        Example:
            rbt.error()
        """
        now = await self._ask("status")
        return None if now["error"] is None else str(now["error"][2])

    async def reachable(self) -> dict[str, list[int]]:
        """The directions in which the tool may go, by frame: X+ X- Y+ Y- Z+ Z- RX+ RX- RY+ RY- RZ+ RZ-, 1 = it may.

        Category: Query

        Example:
            rbt.reachable()
        """
        return dict((await self._ask("status"))["cart_en"])

    async def is_simulator(self) -> bool:
        """Whether commands move the simulated arm.

        Category: Query

        Example:
            rbt.is_simulator()
        """
        return bool((await self._ask("ping"))["simulator"])

    async def is_freedrive(self) -> bool:
        """Whether a hand may move the arm now.

        Category: Query

        Example:
            rbt.is_freedrive()
        """
        return bool((await self._ask("status"))["freedrive"])

    async def tools(self) -> ToolResult:
        """The selected tool, and those that there are.

        Category: Query

        Example:
            rbt.tools()
        """
        return ToolResult(**await self._ask("tools"))

    async def tcp_offset(self) -> list[float]:
        """The offset of the tool's tip, x y z in mm.

        Category: Configuration

        Example:
            rbt.tcp_offset()
        """
        return list(await self._ask("tcp_offset"))

    async def profile(self) -> str:
        """The selected motion profile.

        Category: Query

        Example:
            rbt.profile()
        """
        return str(await self._ask("profile"))

    async def payload(self) -> dict[str, Any]:
        """The load at the tool: mass (kg) and com (m).

        Category: Query

        Example:
            rbt.payload()
        """
        return dict(await self._ask("payload"))

    async def shapes(self) -> list[dict[str, Any]]:
        """The boxes that the arm keeps away from.

        Category: Query

        Example:
            rbt.shapes()
        """
        return list(await self._ask("shapes"))
