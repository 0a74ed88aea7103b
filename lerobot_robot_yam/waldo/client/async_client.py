"""Client of Commander's page: each call is a coroutine.

async with AsyncRobotClient() as rbt:
    await rbt.move_j([0, 60, 60, -29, 0, 0], wait=True)
"""

from collections.abc import Sequence
from typing import Any

from waldoctl import RobotClient as WaldoClient

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.client.state_client import StateClient
from lerobot_robot_yam.waldo.tool_catalog import palette

Numbers = Sequence[float]
_WAIT_S = 60.0  # default timeout of wait=True, s: longer than any move of a YAM
_JAW_S = 3.0  # maximum duration of a jaw motion, s


class AsyncRobotClient(StateClient, WaldoClient):
    """Client of the controller. Lengths in mm, angles in degrees, times in s; gripper 0 open … 1 closed.

    Queued commands return their index, other commands 1. Each call raises ControllerError, with the reason, if the
    controller refuses the call or does not reply. Constructor arguments as for `StateClient`.
    """

    async def _then_wait(self, index: int, wait: bool, timeout: float = _WAIT_S, **_: Any) -> int:
        """Return a command's index, after its end if `wait`. Raises ControllerError: the command did not complete."""
        if wait and not await self.wait_command(index, timeout):
            raise ControllerError(f"command {index} did not end within {timeout:g} s, or was cancelled")
        return index

    async def __aenter__(self) -> "AsyncRobotClient":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    # motion

    @palette("Motion", "rbt.move_j([0, 60, 60, -29, 0, 0], speed=0.5)")
    async def move_j(
        self,
        angles: Numbers | None = None,
        *,
        pose: Numbers | None = None,
        duration: float = 0.0,
        speed: float = 0.0,
        accel: float = 1.0,
        r: float = 0.0,
        rel: bool = False,
        wait: bool = False,
        timeout: float = 10.0,
        **wait_kwargs: Any,
    ) -> int:
        """Move the joints to angles (deg), or to angles that bring the tool to a pose (mm, deg).

        Args:
            duration: duration of the move, s; if above 0, it replaces `speed`.
            speed, accel: fractions 0 … 1 of the limits; speed 0 means the default speed.
            r: blend radius (mm) around the target, within which the next move may begin if it is sent in time.
            rel: whether the numbers are relative to the end of the previous move.
        """
        pace = {"duration": duration, "speed": speed, "accel": accel, "rel": rel, "r": r}
        index = await self._ask("move_j", _WAIT_S, angles=angles, pose=pose, **pace)
        return await self._then_wait(index, wait, timeout)

    @palette("Motion", "rbt.move_l([0, 0, 20, 0, 0, 0], rel=True, speed=0.5)")
    async def move_l(
        self,
        pose: Numbers,
        *,
        frame: str = "WRF",
        duration: float = 0.0,
        speed: float = 0.0,
        accel: float = 1.0,
        r: float = 0,
        rel: bool = False,
        wait: bool = False,
        **wait_kwargs: Any,
    ) -> int:
        """Move the tool along a straight line to a pose (mm, deg). Arguments as for `move_j`."""
        pace = {"duration": duration, "speed": speed, "accel": accel, "rel": rel, "r": r}
        index = await self._ask("move_l", _WAIT_S, pose=pose, frame=frame, **pace)
        return await self._then_wait(index, wait, **wait_kwargs)

    @palette("Motion", "rbt.home()")
    async def home(self, wait: bool = False, calibrate: bool = False, **wait_kwargs: Any) -> int:
        """Move the joints to the home pose: the arm is bent, and no joint is near a limit.

        `calibrate` has no effect: the motors know their angles.
        """
        return await self._then_wait(await self._ask("home", _WAIT_S), wait, **wait_kwargs)

    @palette("Streaming", "rbt.servo_j([0, 60, 60, -29, 0, 0])")
    async def servo_j(
        self, angles: Numbers, *, pose: Numbers | None = None, speed: float = 1.0, accel: float = 1.0
    ) -> int:
        """Track continuously changing joint angles (deg). Each call replaces the previous call's target."""
        return int(await self._ask("servo_j", angles=angles, pose=pose, speed=speed, accel=accel))

    @palette("Streaming", "rbt.servo_l([300, 0, 250, 0, -61, 180])")
    async def servo_l(self, pose: Numbers, *, speed: float = 1.0, accel: float = 1.0) -> int:
        """Track a continuously changing tool pose (mm, deg). Each call replaces the previous call's target."""
        return int(await self._ask("servo_l", pose=pose, speed=speed, accel=accel))

    @palette("Jog", "rbt.jog_j(0, speed=0.3, duration=0.5)")
    async def jog_j(
        self,
        joint: int,
        speed: float = 0.0,
        duration: float = 0.1,
        *,
        joints: Sequence[int] | None = None,
        speeds: Numbers | None = None,
        accel: float = 1.0,
    ) -> int:
        """Turn a joint (0 … 5) for `duration` s at a fraction -1 … 1 of its jog speed."""
        given = {"joints": [joint] if joints is None else joints, "speeds": [speed] if speeds is None else speeds}
        return int(await self._ask("jog_j", **given, duration=duration, accel=accel))

    @palette("Jog", 'rbt.jog_l("WRF", "Z", 0.3, 0.5)')
    async def jog_l(
        self,
        frame: str,
        axis: str | None = None,
        speed: float = 0.0,
        duration: float = 0.1,
        *,
        axes: Sequence[str] | None = None,
        speeds_list: Numbers | None = None,
        accel: float = 1.0,
    ) -> int:
        """Move the tool along or about an axis (X Y Z RX RY RZ) of a frame (WRF, TRF) for `duration` s."""
        given = {"axes": [axis] if axes is None else axes, "speeds": [speed] if speeds_list is None else speeds_list}
        return int(await self._ask("jog_l", frame=frame, **given, duration=duration, accel=accel))

    @palette("I/O", 'rbt.tool_action("LINEAR_4310", "close")')
    async def tool_action(
        self, tool_key: str, action: str, params: Numbers | None = None, *, wait: bool = False, timeout: float = 10.0
    ) -> int:
        """Queue a tool action: `open`, `close`, or `move` to params[0], 0 open … 1 closed."""
        index = await self._ask("tool_action", tool_key=tool_key, action=action, params=params)
        if wait and not await self._ask("wait_command", timeout + _JAW_S, command_index=index, timeout=timeout):
            raise ControllerError(f"{tool_key}: {action} did not end within {timeout:g} s, or was cancelled")
        return 1

    # the queue, and waiting

    @palette("Synchronization", 'rbt.checkpoint("picked")')
    async def checkpoint(self, label: str) -> int:
        """Queue a checkpoint."""
        return int(await self._ask("checkpoint", label=label))

    @palette("Synchronization", "rbt.delay(1.0)")
    async def delay(self, seconds: float) -> int:
        """Queue a pause."""
        return int(await self._ask("delay", seconds=seconds))

    @palette("Synchronization", "rbt.wait_motion()")
    async def wait_motion(self, timeout: float = 10.0, **kwargs: Any) -> bool:
        """Wait until nothing has moved or been queued for `settle_window` s (0.1). Return False after `timeout` s."""
        settle = kwargs.get("settle_window", 0.1)
        return bool(await self._ask("wait_motion", timeout + 1.0, timeout=timeout, settle_window=settle))

    @palette("Synchronization", "rbt.wait_command(rbt.home())")
    async def wait_command(self, command_index: int, timeout: float = 10.0) -> bool:
        """Wait until a queued command has ended. Return False if it was cancelled, or after `timeout` s."""
        return bool(await self._ask("wait_command", timeout + 1.0, command_index=command_index, timeout=timeout))

    async def wait_checkpoint(self, label: str, timeout: float = 30.0) -> bool:
        """Wait until the queue has passed a checkpoint. Return False after `timeout` s."""
        return bool(await self._ask("wait_checkpoint", timeout + 1.0, label=label, timeout=timeout))

    # control

    @palette("Control", "rbt.stop()")
    async def stop(self) -> int:
        """Stop by software, empty the queue, and hold. Torque stays on. The next command moves the arm again."""
        return int(await self._ask("stop"))

    @palette("Control", "rbt.estop()")
    async def estop(self) -> int:
        """Stop by software, empty the queue, hold, and refuse commands until `reset`. TORQUE STAYS ON, since the arm
        has no brakes and would fall.
        """
        return int(await self._ask("estop"))

    @palette("Control", "rbt.reset()")
    async def reset(self) -> int:
        """Accept commands again after `estop` or a resolved fault. Nothing moves, and nothing is energised."""
        return int(await self._ask("reset"))

    @palette("Control", "rbt.halt()")
    async def halt(self) -> int:
        """Call `estop`, under its name in older versions."""
        return await self.estop()

    @palette("Control", "rbt.resume()")
    async def resume(self) -> int:
        """Call `reset`, under its name in older versions."""
        return await self.reset()

    @palette("Control", "rbt.simulator(True)")
    async def simulator(self, enabled: bool) -> int:
        """Select whether commands move the simulated arm or the real arm, which holds its pose. This energises nothing:
        the real arm must be armed first, with `yam-waldo arm`.
        """
        return int(await self._ask("simulator", enabled=bool(enabled)))

    @palette("Control", "rbt.teleport([0, 60, 60, -29, 0, 0])")
    async def teleport(self, angles_deg: Numbers, tool_positions: Numbers | None = None) -> int:
        """Set the simulated arm's joints (deg) and jaws (0 open … 1 closed) at once. Refused for a real arm."""
        return int(await self._ask("teleport", angles_deg=angles_deg, tool_positions=tool_positions))

    @palette("Control", "rbt.freedrive(True)")
    async def freedrive(self, enabled: bool) -> int:
        """Let a person move the real arm by hand with its weight compensated, or make the arm hold its pose."""
        return int(await self._ask("freedrive", enabled=bool(enabled)))

    @palette("Control", "rbt.reset_state()")
    async def reset_state(self) -> int:
        """Stop, and reset tool, offset, payload and shapes to their initial values. Nothing else moves."""
        return int(await self._ask("reset_state"))
