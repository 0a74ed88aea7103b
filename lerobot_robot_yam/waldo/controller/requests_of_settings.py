"""Requests of clients that change how a controller works, or ask for it. None of them moves or energises the arm."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ControllerError, PlanError
from lerobot_robot_yam.waldo.arm_choice import tool_keys
from lerobot_robot_yam.waldo.controller.controller import Controller
from lerobot_robot_yam.waldo.controller.requests_of_motion import MotionRequests
from lerobot_robot_yam.waldo.poses import numbers
from lerobot_robot_yam.waldo.program import PROFILES

_MM = 1e-3
_NO_LOAD = {"mass": 0.0, "com": [0.0, 0.0, 0.0]}


class SettingRequests:
    """Settings of one controller.

    Each method answers the request of its name, see `client.state_client`; YamError says why it is refused.

    Args:
        controller: of the arm.
        motions: its motion commands, which keep away from the shapes.

    Attributes:
        scene_epoch: grows with each change of the shapes.
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
        """Take a load into the model of gravity of the real arm, from the next time on that it is armed."""
        (mass_kg,), com_m = numbers("mass", [mass], 1).tolist(), numbers("com", com, 3).tolist()
        ArmConfig(channel="none", payload_mass_kg=mass_kg, payload_com_m=com_m)  # checks the ranges
        if self._controller.real is not None:
            self._controller.real.load(mass_kg, com_m)
        self._payload = {"mass": mass_kg, "com": com_m}
        return 1

    def payload(self) -> dict[str, Any]:
        return self._payload

    async def set_shapes(self, shapes: Sequence[Mapping[str, Any]]) -> int:
        """Keep away from boxes in the frame of the base: plans do, and the real arm's loop once it is armed."""
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
