"""From arms and open buses to a control loop."""

from collections.abc import Sequence

from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.loop import ControlLoop
from lerobot_robot_yam.control.safety.collision_guard import WorkspaceGuard
from lerobot_robot_yam.control.state_publisher import ControllerBlocks
from lerobot_robot_yam.control.teleop.lead import make_leads
from lerobot_robot_yam.state.records import BlockPair


def build(arms: Sequence[ResolvedArm], keys: Sequence[str], buses: Sequence, pairs: Sequence[BlockPair]) -> ControlLoop:
    """Build controllers on open buses and inspect them: what can be refused without torque is refused here.

    Raises:
        YamError: names the part that is not as configured.
    """
    controllers = [ArmController(arm, bus) for arm, bus in zip(arms, buses, strict=True)]
    for controller, lead in zip(controllers, make_leads(arms), strict=True):
        controller.lead = lead
    for controller in controllers:
        controller.inspect()
    guarded = [GuardedArm(arm.name, arm.arm, arm.gripper, arm.config.workspace, arm.tilt_rad) for arm in arms]
    limited = any(arm.config.workspace.limits_anything for arm in arms)
    guard = WorkspaceGuard(guarded) if limited else None
    blocks: list[ControllerBlocks] = []
    try:
        for controller, key, pair in zip(controllers, keys, pairs, strict=True):
            blocks.append(ControllerBlocks(controller, key, pair))
        return ControlLoop(controllers, blocks, arms[0].config.rate_hz, guard)
    except BaseException:
        for made in blocks:
            made.close(remove=True)
        raise
