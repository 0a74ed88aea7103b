"""Client that moves nothing: it plans a program as the controller does, for the preview of the path.

The client reads no clock, since Commander's preview stops all clocks.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from waldoctl import DryRunResultData, ToolSpec

from lerobot_robot_yam.waldo import program
from lerobot_robot_yam.waldo.arm_choice import NO_TOOL, ArmChoice, tip, tool_key
from lerobot_robot_yam.waldo.planning.motion_plan import Plan
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import Numbers, check_frame, numbers, to_command, to_vector
from lerobot_robot_yam.waldo.tool_catalog import YamTools, tools_of

_ROW_S = 0.02  # time between two rows of a result, s: Commander plays 50 rows per second
_MM = 1e-3
_PACE = ("frame", "rel", "speed", "accel", "duration")


class DryTool:
    """Selected tool in a preview. Its actions last as long as the jaws would take, and the arm stays at rest.

    `client`: client of the preview; `tool`: description of the tool.
    """

    def __init__(self, client: "DryRunClient", tool: ToolSpec):
        self._client, self._tool = client, tool

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tool, name)

    def open(self, **_: Any) -> DryRunResultData | None:
        """Open the jaws."""
        return self._client._jaws("open")

    def close(self, **_: Any) -> DryRunResultData | None:
        """Close the jaws."""
        return self._client._jaws("close")

    def set_position(self, position: float, **_: Any) -> DryRunResultData | None:
        """Move the jaws to a position, 0 open … 1 closed."""
        return self._client._jaws("move", position)


class DryRunClient:
    """Planner of a program's motions, starting from an initial pose. Results in m and rad, arguments in mm and deg.

    `initial_joints_deg`: initial joints (6,); None: the home pose.

    A motion that cannot be planned raises PlanError and leaves the state unchanged.
    """

    def __init__(self, initial_joints_deg: Sequence[float] | None = None, **_: Any):
        self._choice = ArmChoice.of_environment()
        self._hardware = self._choice.resolved()
        self._planner, self._key = Planner(self._hardware), NO_TOOL
        given = None if initial_joints_deg is None else numbers("initial_joints_deg", initial_joints_deg, 6)
        self._q = self._planner.home_q if given is None else np.radians(given)
        self._opening = 0.0  # jaw position, 0 open … 1 closed as in Commander
        self._held: tuple[Plan, float] | None = None  # motion to blend with the next one, and blend radius, m

    @property
    def _tools(self) -> YamTools:
        return tools_of(self._choice)

    @property
    def tool(self) -> DryTool:
        return DryTool(self, self._tools[self._key])

    def angles(self) -> list[float]:
        """Return the joint angles, deg."""
        return list(np.degrees(self._q).tolist())

    def pose(self, frame: str = "WRF") -> list[float]:
        """Return the tool pose, x y z rx ry rz in mm and deg."""
        here = self._planner.pose(self._q)
        return list(to_command(np.eye(4) if check_frame(frame) == "TRF" else here).tolist())

    def move_j(
        self, angles: Numbers | None = None, *, pose: Numbers | None = None, r: float = 0.0, **pace: Any
    ) -> DryRunResultData | None:
        """Plan the motion of `AsyncRobotClient.move_j`."""
        return self._moved(program.move_j(self._planner, self._q, angles, pose, **_pace(pace)), r)

    def move_l(self, pose: Numbers, *, r: float = 0.0, **pace: Any) -> DryRunResultData | None:
        """Plan the motion of `AsyncRobotClient.move_l`."""
        return self._moved(program.move_l(self._planner, self._q, pose, **_pace(pace)), r)

    def home(self, *_: Any, **__: Any) -> DryRunResultData | None:
        """Plan the motion of `AsyncRobotClient.home`."""
        return self._moved(self._planner.home(self._q))

    def servo_j(self, angles: Numbers, *, pose: Numbers | None = None, **_: Any) -> DryRunResultData | None:
        """Plan a move to the target of the stream."""
        return self.move_j(None if pose is not None else angles, pose=pose)

    def servo_l(self, pose: Numbers, **_: Any) -> DryRunResultData | None:
        """Plan a move to the target of the stream."""
        return self.move_j(pose=pose)

    def delay(self, seconds: float) -> DryRunResultData | None:
        """Plan the pause of `AsyncRobotClient.delay`."""
        return self._moved(program.pause(self._q, seconds))

    def teleport(self, angles_deg: Numbers, tool_positions: Numbers | None = None) -> int:
        """Set joints and jaws at once. A motion held back for blending is dropped, as in the controller."""
        q = self._planner.within(np.radians(numbers("angles", angles_deg, len(self._q))))
        if tool_positions is not None and len(tool_positions):
            self._opening = float(np.clip(numbers("tool_positions", tool_positions, 1)[0], 0.0, 1.0))
        self._q, self._held = q, None
        return 1

    def select_tool(self, tool_name: str, variant_key: str = "") -> int:
        """Select the tool whose tip all poses refer to."""
        key = tool_name.upper()
        self._planner.kinematics.tool, self._key = tip(self._hardware.gripper, key, np.zeros(3)), key
        return 1

    def set_tcp_offset(self, x: float = 0, y: float = 0, z: float = 0) -> int:
        """Shift the tool's tip by x y z, mm, in the tool frame."""
        self._planner.kinematics.tool = tip(self._hardware.gripper, self._key, numbers("an offset", [x, y, z], 3) * _MM)
        return 1

    def checkpoint(self, label: str) -> int:
        """Do nothing: previews do not show checkpoints."""
        return 1

    def wait_motion(self, *_: Any, **__: Any) -> bool:
        """Return True, since planned motions count as completed."""
        return True

    wait_command = wait_checkpoint = wait_ready = wait_status = wait_motion

    def flush(self) -> list[DryRunResultData]:
        """Return the result held back for blending with the next motion, as a list of at most one element."""
        held, self._held = self._held, None
        return [] if held is None else [result_of(held[0], self._planner.pose)]

    def close(self) -> None:
        """Do nothing."""

    def __enter__(self) -> "DryRunClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _jaws(self, action: str, *params: float) -> DryRunResultData | None:
        gripper = self._hardware.gripper  # the page may have selected the tool, which previews do not see
        goal = program.jaw_position(gripper, tool_key(gripper), action, list(params))
        stroke_s = abs(goal - self._opening) / float(self._hardware.speed_limit[-1])
        self._opening = goal
        return self._moved(program.pause(self._q, stroke_s))

    def _moved(self, plan: Plan, r: float = 0.0) -> DryRunResultData | None:
        """Return the result of a motion, joined to the one held back; None if it is itself held back for blending."""
        radius_m = program.radius(r)
        if self._held is not None:
            first, before_m = self._held
            plan = self._planner.joined(first, plan, before_m)
        self._q = plan.q[-1].copy()
        self._held = (plan, radius_m) if radius_m else None
        return None if radius_m else result_of(plan, self._planner.pose)


def _pace(given: dict[str, Any]) -> dict[str, Any]:
    """Return the motion's arguments without those for waiting: planned motions count as completed."""
    return {name: value for name, value in given.items() if name in _PACE}


def result_of(plan: Plan, pose: Callable[[np.ndarray], np.ndarray]) -> DryRunResultData:
    """Convert a plan to Commander's form, with rows evenly spaced over the plan's duration.

    `pose`: function from joints (…, n), rad, to poses (…, 4, 4), m.
    """
    rows = max(int(np.ceil(plan.duration_s / _ROW_S)), 1) + 1
    q = plan.at(np.linspace(0.0, plan.duration_s, rows))[0]
    return DryRunResultData(
        tcp_poses=to_vector(pose(q)),
        end_joints_rad=q[-1].copy(),
        duration=plan.duration_s,
        joint_trajectory_rad=q,
    )
