"""The calls of a client that move the arm, stop it, and wait for it. Lengths in mm, angles in degrees, times in s."""

from collections.abc import Sequence
from typing import Any

from lerobot_robot_yam.waldo.client.asking import Asking

Numbers = Sequence[float]
_WAIT_S = 60.0  # of a call with wait=True that gives no time-out: longer than any move of a YAM


class MotionCalls(Asking):
    """Motion commands of a client; each raises ControllerError where the controller refuses it."""

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
        """Move the joints to angles (deg), or to where they bring the tool to a pose (mm, deg). Returns the index.

        Args:
            duration: s; above 0 it counts in place of `speed`.
            speed, accel: shares 0 … 1 of the limits; 0 is the default speed.
            r: radius (mm) around the target within which the next move may begin, if it is sent in time.
            rel: the numbers are added to where the move before ends.

        Category: Motion

        Example:
            rbt.move_j([0, 60, 60, -29, 0, 0], speed=0.5)
        """
        given = {
            "angles": angles,
            "pose": pose,
            "duration": duration,
            "speed": speed,
            "accel": accel,
            "rel": rel,
            "r": r,
        }
        return await self._then_wait(await self._ask("move_j", _WAIT_S, **given), wait, timeout)

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
        """Move the tool along a straight line to a pose (mm, deg). Returns the index.

        Category: Motion

        Example:
            rbt.move_l([0, 0, 20, 0, 0, 0], rel=True, speed=0.5)
        """
        given = {"pose": pose, "frame": frame, "duration": duration, "speed": speed, "accel": accel, "rel": rel, "r": r}
        index = await self._ask("move_l", _WAIT_S, **given)
        return await self._then_wait(index, wait, wait_kwargs.get("timeout", _WAIT_S))

    async def home(self, wait: bool = False, calibrate: bool = False, **wait_kwargs: Any) -> int:
        """Move the joints to the home pose, where the arm is bent and nothing is near a limit. Returns the index.

        `calibrate` changes nothing: the motors know their angles.

        Category: Motion

        Example:
            rbt.home()
        """
        index = await self._ask("home", _WAIT_S)
        return await self._then_wait(index, wait, wait_kwargs.get("timeout", _WAIT_S))

    async def servo_j(
        self, angles: Numbers, *, pose: Numbers | None = None, speed: float = 1.0, accel: float = 1.0
    ) -> int:
        """Follow joint angles (deg) that change all the time: the newest replaces the one before.

        Category: Streaming

        Example:
            rbt.servo_j([0, 60, 60, -29, 0, 0])
        """
        return int(await self._ask("servo_j", angles=angles, pose=pose, speed=speed, accel=accel))

    async def servo_l(self, pose: Numbers, *, speed: float = 1.0, accel: float = 1.0) -> int:
        """Follow a pose of the tool (mm, deg) that changes all the time: the newest replaces the one before.

        Category: Streaming

        Example:
            rbt.servo_l([300, 0, 250, 0, -61, 180])
        """
        return int(await self._ask("servo_l", pose=pose, speed=speed, accel=accel))

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
        """Turn a joint (0 … 5), at a share -1 … 1 of its jog speed, for `duration` s and no longer.

        Category: Jog

        Example:
            rbt.jog_j(0, speed=0.3, duration=0.5)
        """
        given = {"joints": [joint] if joints is None else joints, "speeds": [speed] if speeds is None else speeds}
        return int(await self._ask("jog_j", **given, duration=duration, accel=accel))

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
        """Move the tool along or about an axis (X Y Z RX RY RZ) of a frame (WRF, TRF) for `duration` s.

        Category: Jog

        Example:
            rbt.jog_l("WRF", "Z", 0.3, 0.5)
        """
        given = {"axes": [axis] if axes is None else axes, "speeds": [speed] if speeds_list is None else speeds_list}
        return int(await self._ask("jog_l", frame=frame, **given, duration=duration, accel=accel))

    async def wait_motion(self, timeout: float = 10.0, **kwargs: Any) -> bool:
        """Wait until nothing moves or is queued, and stays so for `settle_window` s (0.1). False: after `timeout` s.

        Category: Synchronization

        Example:
            rbt.wait_motion()
        """
        settle = kwargs.get("settle_window", 0.1)
        return bool(await self._ask("wait_motion", timeout + 1.0, timeout=timeout, settle_window=settle))

    async def wait_command(self, command_index: int, timeout: float = 10.0) -> bool:
        """Wait until a queued command has ended. False: it was cancelled, or has not ended after `timeout` s.

        Category: Synchronization

        Example:
            rbt.wait_command(rbt.home())
        """
        return bool(await self._ask("wait_command", timeout + 1.0, command_index=command_index, timeout=timeout))

    async def wait_checkpoint(self, label: str, timeout: float = 30.0) -> bool:
        """Wait until the queue has passed a checkpoint. False: not within `timeout` s."""
        return bool(await self._ask("wait_checkpoint", timeout + 1.0, label=label, timeout=timeout))

    async def checkpoint(self, label: str) -> int:
        """Put a mark into the queue. Returns the index.

        Category: Synchronization

        Example:
            rbt.checkpoint("picked")
        """
        return int(await self._ask("checkpoint", label=label))

    async def delay(self, seconds: float) -> int:
        """Put a pause into the queue. Returns the index.

        Category: Synchronization

        Example:
            rbt.delay(1.0)
        """
        return int(await self._ask("delay", seconds=seconds))

    async def stop(self) -> int:
        """Stop, empty the queue, and hold: the next command is taken. In software; torque stays on.

        Category: Control

        Example:
            rbt.stop()
        """
        return int(await self._ask("stop"))

    async def estop(self) -> int:
        """Stop, empty the queue, hold, and take no commands until `reset`. In software: TORQUE STAYS ON, the arm has
        no brakes and would fall.

        Category: Control

        Example:
            rbt.estop()
        """
        return int(await self._ask("estop"))

    async def reset(self) -> int:
        """Take commands again after `estop` or a fault that has passed. Nothing moves, nothing is energised.

        Category: Control

        Example:
            rbt.reset()
        """
        return int(await self._ask("reset"))

    async def halt(self) -> int:
        """As `estop`: its name in older versions.

        Category: Control

        Example:
            rbt.halt()
        """
        return await self.estop()

    async def resume(self) -> int:
        """As `reset`: its name in older versions.

        Category: Control

        Example:
            rbt.resume()
        """
        return await self.reset()
