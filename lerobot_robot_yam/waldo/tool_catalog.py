"""Commander's tools of an arm: none, and the mounted gripper. Jaw positions are 0 open … 1 closed.

`palette` marks calls for the palette of Commander's editor, which lists calls whose docstring contains a category and
an example.
"""

import inspect
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, TypeVar

from waldoctl import (
    ChannelDescriptor,
    ElectricGripperTool,
    LinearMotion,
    MeshRole,
    MeshSpec,
    ToolSpec,
    ToolsSpec,
    ToolType,
)

from lerobot_robot_yam.arm.export.model_export import rpy
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.arm_choice import NO_TOOL, ArmChoice, tool_centre, tool_key
from lerobot_robot_yam.waldo.arm_model import ArmModel

Call = TypeVar("Call", bound=Callable[..., object])


def palette(category: str, example: str) -> Callable[[Call], Call]:
    """Decorate a call so that the palette lists it, with a category and a one-line example."""

    def shown(call: Call) -> Call:
        call.__doc__ = f"{inspect.getdoc(call)}\n\nCategory: {category}\n\nExample:\n    {example}\n"
        return call

    return shown


class NoTool(ToolSpec):
    """Tool "NONE": the bare flange."""


class YamGripper(ElectricGripperTool):
    """Gripper with a motor. Actions need a client; a gripper from `Robot.tools` has none and is only a description.

    `client`: client that executes the actions, or None; `spec`: arguments of `ToolSpec`.
    """

    def __init__(self, client: Any = None, **spec: Any):
        super().__init__(position_range=(0.0, 1.0), speed_range=(1.0, 1.0), current_range=(0.0, 0.0), **spec)
        self._client = client

    @property
    def channel_descriptors(self) -> tuple[ChannelDescriptor, ...]:
        """Description of `ToolStatus.channels`: the gripper motor's torque."""
        return (ChannelDescriptor("motor torque", "Nm"),)

    @palette("Gripper", "rbt.tool.set_position(0.5)")
    async def set_position(self, position: float, **kwargs: Any) -> int:
        """Move the jaws to a position, 0 open … 1 closed."""
        return await self._act("move", [position], **kwargs)

    @palette("Gripper", "rbt.tool.open()")
    async def open(self, **kwargs: Any) -> int:
        """Open the jaws."""
        return await self._act("open", None, **kwargs)

    @palette("Gripper", "rbt.tool.close()")
    async def close(self, **kwargs: Any) -> int:
        """Close the jaws. The force on an object between them is limited to the gripper's maximum."""
        return await self._act("close", None, **kwargs)

    async def _act(self, action: str, params: list[float] | None, wait: bool = False, timeout: float = 10.0) -> int:
        if self._client is None:
            raise ControllerError(f"{self.key}: this only describes the tool; use the `tool` of a client")
        return int(await self._client.tool_action(self.key, action, params, wait=wait, timeout=timeout))


class YamTools(ToolsSpec):
    """Tools of one arm, in display order. The first is the bare flange."""

    def __init__(self, *tools: ToolSpec):
        self._tools = {tool.key: tool for tool in tools}

    @property
    def available(self) -> tuple[ToolSpec, ...]:
        return tuple(self._tools.values())

    @property
    def default(self) -> ToolSpec:
        return self._tools[NO_TOOL]

    def __getitem__(self, key: str) -> ToolSpec:
        return self._tools[key]

    def __contains__(self, item: object) -> bool:
        return item in self._tools or any(tool.tool_type == item for tool in self._tools.values())

    def __iter__(self) -> Iterator[ToolSpec]:
        return iter(self._tools.values())

    def by_type(self, tool_type: ToolType) -> tuple[ToolSpec, ...]:
        return tuple(tool for tool in self._tools.values() if tool.tool_type == tool_type)


@cache
def model_of(choice: ArmChoice) -> ArmModel:
    """Return Commander's model of an arm and its gripper. Raises ConfigError: a profile is unknown."""
    return ArmModel(*resolve_profiles(choice.arm, choice.gripper))


def tools_of(choice: ArmChoice, client: Any = None) -> YamTools:
    """Return the tools of an arm, bound to `client` if given. Raises ConfigError: a profile is unknown."""
    _, gripper = resolve_profiles(choice.arm, choice.gripper)
    none = NoTool(key=NO_TOOL, display_name="None", tool_type=ToolType.NONE, tcp_origin=(0.0,) * 3, tcp_rpy=(0.0,) * 3)
    if gripper.motor is None:
        return YamTools(none)
    return YamTools(none, YamGripper(client, **_looks(gripper, model_of(choice))))


def bound_tool(key: str, client: Any) -> ToolSpec:
    """Return the tool with this key for the arm given by the environment. Its actions call `client`."""
    return tools_of(ArmChoice.of_environment(), client)[key]


def _looks(gripper: GripperProfile, model: ArmModel) -> dict[str, Any]:
    """Return the `ToolSpec` arguments for a gripper: name, tip, meshes and finger motion, in the flange frame."""
    assert gripper.motor is not None
    tip = tool_centre(gripper)
    parts = ((MeshRole.BODY, model.body_meshes), (MeshRole.JAW, model.jaw_meshes))
    meshes = [MeshSpec(file, role=role) for role, files in parts for file in files]
    motions = []
    if model.jaws is not None:
        x, y, z = model.jaws.axis.tolist()
        travel_m, speed = model.jaws.travel_m, gripper.motor.speed_limit_per_s
        motions.append(
            LinearMotion(MeshRole.JAW, (x, y, z), travel_m, symmetric=True, estimated_speed_m_s=speed * travel_m)
        )
    return {
        "key": tool_key(gripper),
        "display_name": gripper.name.replace("_", " "),
        "tcp_origin": tuple(tip[:3, 3].tolist()),
        "tcp_rpy": tuple(rpy(tip[:3, :3]).tolist()),
        "meshes": tuple(meshes),
        "motions": tuple(motions),
    }
