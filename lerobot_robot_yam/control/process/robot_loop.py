"""The parts of a robot, arms and a mobile base: their controllers, blocks and loop."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import can
import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.loop import ControlLoop
from lerobot_robot_yam.control.mobile.base_blocks import BaseBlocks
from lerobot_robot_yam.control.mobile.base_controller import BaseController
from lerobot_robot_yam.control.part_controller import Blocks
from lerobot_robot_yam.control.state_publisher import ControllerBlocks
from lerobot_robot_yam.control.teleop.lead import make_leads
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.mobile.robot_parts import Part
from lerobot_robot_yam.state.records import BlockPair

if TYPE_CHECKING:
    from lerobot_robot_yam.arm.dynamics import GravityModel
    from lerobot_robot_yam.control.safety.collision_guard import WorkspaceGuard

PartController = ArmController | BaseController


def make_controller(part: Part, bus: can.BusABC, gravity: "GravityModel | None" = None) -> PartController:
    """Make the controller of a part. gravity: an arm's gravity model, if one was made before."""
    return BaseController(part, bus) if isinstance(part, ResolvedBase) else ArmController(part, bus, gravity)


def make_blocks(controller: PartController, key: str, pair: BlockPair, adopt: np.ndarray | None = None) -> Blocks:
    """Connect a controller with its blocks. adopt: the last state of a loop that has died."""
    if isinstance(controller, BaseController):
        return BaseBlocks(controller, key, pair, adopt)
    return ControllerBlocks(controller, key, pair, adopt)


def introduce(controllers: Sequence[PartController]) -> None:
    """Tell each base of the other parts of its robot: it keeps its torque until they are off."""
    for base in controllers:
        if isinstance(base, BaseController):
            base.peers = [other.status for other in controllers if other is not base]


def build(parts: Sequence[Part], keys: Sequence[str], buses: Sequence, pairs: Sequence[BlockPair]) -> ControlLoop:
    """Create and inspect controllers on open buses, so that errors are found before any part has torque.

    Raises:
        YamError: a part is not as configured; the message names it.
    """
    arms = [part for part in parts if isinstance(part, ResolvedArm)]
    controllers = [make_controller(part, bus) for part, bus in zip(parts, buses, strict=True)]
    introduce(controllers)
    armed = [controller for controller in controllers if isinstance(controller, ArmController)]
    for controller, lead in zip(armed, make_leads(arms), strict=True):
        controller.lead = lead
    blocks: list[Blocks] = []
    try:
        for part in controllers:
            part.inspect()
        for part, key, pair in zip(controllers, keys, pairs, strict=True):
            blocks.append(make_blocks(part, key, pair))
        return ControlLoop(controllers, blocks, parts[0].config.rate_hz, _guard(arms))
    except BaseException:
        for part in controllers:
            part.close()
        for made in blocks:
            made.close(remove=True)
        raise


def _guard(arms: Sequence[ResolvedArm]) -> "WorkspaceGuard | None":
    """Create the guard against collisions; None if no arm limits its workspace."""
    if not any(arm.config.workspace.limits_anything for arm in arms):
        return None
    from lerobot_robot_yam.arm.collision.parts import GuardedArm  # late imports of MuJoCo
    from lerobot_robot_yam.control.safety.collision_guard import WorkspaceGuard

    return WorkspaceGuard(
        [GuardedArm(arm.name, arm.arm, arm.gripper, arm.config.workspace, arm.tilt_rad) for arm in arms]
    )
