"""From configs and open buses to a control loop."""

from collections.abc import Sequence

from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.loop import ControlLoop
from lerobot_robot_yam.control.safety.collision_guard import WorkspaceGuard
from lerobot_robot_yam.control.state_publisher import ControllerBlocks
from lerobot_robot_yam.state.block_pair import BlockPair


def _workspace_guard(controllers: Sequence[ArmController]) -> WorkspaceGuard | None:
    """What keeps these arms clear of things and each other; None when nothing is forbidden."""
    if not any(c.config.workspace.limits_anything for c in controllers):
        return None
    return WorkspaceGuard(
        [
            GuardedArm(
                c.name,
                c.actuation.hardware.arm,
                c.actuation.hardware.gripper,
                c.config.workspace,
                c.actuation.hardware.tilt_rad,
            )
            for c in controllers
        ]
    )


def build(
    configs: Sequence[ArmConfig], keys: Sequence[str], buses: Sequence, pairs: Sequence[BlockPair]
) -> ControlLoop:
    """Controllers on open buses, inspected: everything that can be refused without torque is refused here.

    Raises:
        YamError: names the part that is not as configured.
    """
    controllers = [ArmController(config, bus) for config, bus in zip(configs, buses, strict=True)]
    for controller in controllers:
        controller.inspect()
    blocks: list[ControllerBlocks] = []
    try:
        for controller, key, pair in zip(controllers, keys, pairs, strict=True):
            blocks.append(ControllerBlocks(controller, key, pair))
        return ControlLoop(controllers, blocks, configs[0].rate_hz, _workspace_guard(controllers))
    except BaseException:
        for made in blocks:
            made.close(remove=True)
        raise
