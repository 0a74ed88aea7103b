"""Requests of clients: motions planned in a thread and queued in order, motions streamed immediately, and settings.

The method for a request has the name, arguments, units and results of the client's call (see `client`). It raises
YamError with the reason if the request is refused.
"""

import asyncio
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ControllerError, PlanError
from lerobot_robot_yam.waldo import program
from lerobot_robot_yam.waldo.arm_choice import tool_keys
from lerobot_robot_yam.waldo.controller.controller import TICK_S, Controller
from lerobot_robot_yam.waldo.controller.motion import Blend, Command, End
from lerobot_robot_yam.waldo.planning.jog import JOG_S, JointJog, LineJog, Play, Stream
from lerobot_robot_yam.waldo.planning.motion_plan import Plan
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import Numbers, from_command, numbers
from lerobot_robot_yam.waldo.program import PROFILES, swapped

_STILL_RAD_S = 0.05  # joint speed up to which the arm counts as still, rad/s: three resolution steps of its report
_MM = 1e-3
_NO_LOAD = {"mass": 0.0, "com": [0.0, 0.0, 0.0]}


class MotionRequests:
    """Motion requests to one controller. Each public method except `set_workspace` and `close` implements a request."""

    def __init__(self, controller: Controller):
        self._controller, self._motion = controller, controller.motion
        self._planner = Planner(controller.hardware)  # for use in the planning thread only
        self._worker = ThreadPoolExecutor(1, "planning")
        self._in_turn = asyncio.Lock()

    def close(self) -> None:
        self._worker.shutdown(cancel_futures=True)

    async def set_workspace(self, workspace: WorkspaceConfig) -> None:
        """Use this workspace for all subsequent plans."""
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(self._worker, lambda: self._planner.keep_clear(workspace))

    async def move_j(self, angles: Numbers | None, pose: Numbers | None = None, r: float = 0.0, **pace: Any) -> int:
        command = Command("move_j", _text(angles if pose is None else pose), radius_m=program.radius(r))
        return await self._planned(command, lambda p, q: program.move_j(p, q, angles, pose, **pace))

    async def move_l(self, pose: Numbers, r: float = 0.0, **pace: Any) -> int:
        command = Command("move_l", _text(pose), radius_m=program.radius(r))
        return await self._planned(command, lambda p, q: program.move_l(p, q, pose, **pace))

    async def home(self) -> int:
        return await self._planned(Command("home"), lambda p, q: p.home(q))

    async def delay(self, seconds: float) -> int:
        command = Command("delay", f"{seconds} s")
        return await self._planned(command, lambda p, q: program.pause(q, seconds), blends=False)

    async def _planned(self, command: Command, plan: Callable[[Planner, np.ndarray], Plan], blends: bool = True) -> int:
        """Plan and queue a command that starts where the queued motions end; return the command's index.

        `blends`: whether the motion may be blended with the last queued motion.
        """
        motion, epoch = self._motion, self._motion.epoch
        async with self._in_turn:
            self._controller.check_enabled()
            motion.end_stream()
            while motion.streams:
                await asyncio.sleep(TICK_S)
            start_q, tip = motion.end_q, self._controller.tip
            first = motion.blending if blends else None
            radius_m = motion.waiting[-1].radius_m if first is not None else 0.0

            def work() -> tuple[Plan, Blend | None]:
                self._planner.kinematics.tool = tip
                made = plan(self._planner, start_q)
                return made, first and Blend(first, self._planner.joined(first, made, radius_m))

            command.plan, blend = await asyncio.get_running_loop().run_in_executor(self._worker, work)
            self._controller.check_enabled()
            return motion.add(command, epoch, blend)

    async def checkpoint(self, label: str) -> int:
        return await self._unplanned(Command("checkpoint", str(label), label=str(label)))

    async def tool_action(self, tool_key: str, action: str, params: Sequence[float] | None = None) -> int:
        gripper = self._controller.hardware.gripper
        opening = swapped(program.jaw_position(gripper, str(tool_key).upper(), action, params))
        return await self._unplanned(Command(f"tool {action}", str(tool_key), opening=opening))

    async def _unplanned(self, command: Command) -> int:
        epoch = self._motion.epoch
        async with self._in_turn:
            self._controller.check_enabled()
            return self._motion.add(command, epoch)

    # streams

    def servo_j(
        self, angles: Numbers | None, pose: Numbers | None = None, speed: float = 1.0, accel: float = 1.0
    ) -> int:
        if pose is not None:
            return self.servo_l(pose, speed, accel)
        target = np.radians(numbers("angles", angles, self._controller.hardware.joints))
        return self._stream(lambda: self._servo(target, speed, accel))

    def servo_l(self, pose: Numbers, speed: float = 1.0, accel: float = 1.0) -> int:
        target, planner = from_command(pose), self._controller.planner
        return self._stream(lambda: self._servo(planner.inverse(target, self._motion.q, turn_over=False), speed, accel))

    def _servo(self, target: np.ndarray, speed: float, accel: float) -> Play:
        q, dq = self._motion.setpoint
        return Play(self._controller.planner.joints(q, target, speed=speed, accel=accel, start_dq=dq))

    def jog_j(self, joints: Sequence[int], speeds: Numbers, duration: float = JOG_S, accel: float = 1.0) -> int:
        wanted, controller = dict(zip(joints, speeds, strict=True)), self._controller
        return self._stream(lambda: JointJog(controller.planner, wanted, controller.now(), duration, accel))

    def jog_l(
        self, frame: str, axes: Sequence[str], speeds: Numbers, duration: float = JOG_S, accel: float = 1.0
    ) -> int:
        wanted, controller, start = dict(zip(axes, speeds, strict=True)), self._controller, self._motion.setpoint
        return self._stream(
            lambda: LineJog(controller.planner, frame, wanted, start, controller.now(), duration, accel)
        )

    def _stream(self, begin: Callable[[], Stream]) -> int:
        self._controller.check_enabled()
        self._motion.stream(begin)
        return 1

    # waits

    async def wait_command(self, command_index: int, timeout: float = 10.0) -> bool:
        await _until(lambda: self._motion.end_of(command_index) is not None, timeout)
        return self._motion.end_of(command_index) is End.DONE

    async def wait_checkpoint(self, label: str, timeout: float = 30.0) -> bool:
        return await _until(lambda: self._motion.checkpoint == label, timeout)

    async def wait_motion(self, timeout: float = 10.0, settle_window: float = 0.1) -> bool:
        controller, still_since_s = self._controller, [np.inf]

        def settled() -> bool:
            speeds = np.abs(controller.reading.dq).max()
            moving = self._motion.planned or self._motion.streams or speeds > _STILL_RAD_S
            still_since_s[0] = np.inf if moving else min(still_since_s[0], controller.now())
            return controller.now() - still_since_s[0] >= settle_window

        return await _until(settled, timeout)


async def _until(condition: Callable[[], bool], timeout: float) -> bool:
    """Wait until `condition` is true. Return False after `timeout` s."""
    try:
        async with asyncio.timeout(timeout):
            while not condition():
                await asyncio.sleep(TICK_S)
    except TimeoutError:
        return False
    return True


def _text(values: Any) -> str:
    """Format a client's numbers for the status. Return "" if they are malformed."""
    try:
        return " ".join(f"{float(value):.1f}" for value in values)
    except (TypeError, ValueError):
        return ""


class SettingRequests:
    """Settings of one controller. No setting moves or energises the arm, except that `reset_state` stops the arm.

    `motions`: the controller's motion requests, which avoid the shapes.

    Attributes:
        scene_epoch: counter that grows with each change of the shapes.
    """

    def __init__(self, controller: Controller, motions: MotionRequests):
        self._controller, self._motions = controller, motions
        self._payload: dict[str, Any] = dict(_NO_LOAD)
        self._shapes: list[dict[str, Any]] = []
        self.scene_epoch = 0

    def tools(self) -> dict[str, Any]:
        return {"tool": self._controller.tool_key, "available": tool_keys(self._controller.hardware.gripper)}

    def select_tool(self, tool_name: str, variant_key: str = "") -> int:
        self._controller.use_tool(str(tool_name).upper(), np.zeros(3))
        return 1

    def set_tcp_offset(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> int:
        self._controller.use_tool(self._controller.tool_key, numbers("an offset", [x, y, z], 3) * _MM)
        return 1

    def tcp_offset(self) -> list[float]:
        offset: list[float] = (self._controller.offset_m / _MM).tolist()
        return offset

    def select_profile(self, profile: str) -> int:
        if profile not in PROFILES:
            raise ControllerError(f"no motion profile {profile!r}; there is {', '.join(PROFILES)}")
        return 1

    def profile(self) -> str:
        return PROFILES[0]

    def connect_hardware(self, port_str: str) -> int:
        real = self._controller.real
        if real is None or port_str != real.config.channel:
            have = "none" if real is None else real.config.channel
            raise ControllerError(
                f"the channel is chosen at the arm's computer (yam-waldo --hardware --channel …), not here: this "
                f"controller has {have}, not {port_str!r}"
            )
        return 1

    def set_payload(self, mass: float, com: Sequence[float] = (0.0, 0.0, 0.0)) -> int:
        """Set the payload in the real arm's gravity model, effective from the next arming."""
        (mass_kg,), com_m = numbers("mass", [mass], 1).tolist(), numbers("com", com, 3).tolist()
        ArmConfig(channel="none", payload_mass_kg=mass_kg, payload_com_m=com_m)  # checks the ranges
        if self._controller.real is not None:
            self._controller.real.load(mass_kg, com_m)
        self._payload = {"mass": mass_kg, "com": com_m}
        return 1

    def payload(self) -> dict[str, Any]:
        return self._payload

    async def set_shapes(self, shapes: Sequence[Mapping[str, Any]]) -> int:
        """Set boxes to avoid, in the base frame. Plans avoid them at once, the real arm's loop from the next arming."""
        if not all(isinstance(shape, Mapping) for shape in shapes):
            raise PlanError("a shape is {name, center_m, size_m, yaw_rad}: a box in the frame of the base")
        own = self._controller.hardware.config.workspace
        workspace = WorkspaceConfig.from_mapping(
            {**dataclasses.asdict(own), "keep_out": [*map(dataclasses.asdict, own.keep_out), *shapes]}
        )
        workspace.check(self._controller.hardware.name)
        if self._controller.real is not None:
            self._controller.real.keep_clear(workspace)
        self._controller.planner.keep_clear(workspace)
        await self._motions.set_workspace(workspace)
        self._shapes = [dict(shape) for shape in shapes]
        self.scene_epoch += 1
        return 1

    def shapes(self) -> list[dict[str, Any]]:
        return self._shapes

    async def reset_state(self) -> int:
        self._controller.stop()
        self.select_tool("NONE")
        if self._payload != _NO_LOAD:
            self.set_payload(0.0)
        if self._shapes:
            await self.set_shapes([])
        return 1
