"""From configs and open buses to a control loop."""

from collections.abc import Sequence

from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.loop import ControlLoop
from lerobot_robot_yam.control.safety.collision_guard import WorkspaceGuard
from lerobot_robot_yam.control.state_publisher import ControllerBlocks
from lerobot_robot_yam.state.records import BlockPair


def _workspace_guard(controllers: Sequence[ArmController]) -> WorkspaceGuard | None:
    """The guard that keeps these arms clear of things and each other; None when nothing is forbidden."""
    if not any(c.config.workspace.limits_anything for c in controllers):
        return None
    described = [(c.name, c.actuation.hardware, c.config.workspace) for c in controllers]
    return WorkspaceGuard([GuardedArm(name, hw.arm, hw.gripper, where, hw.tilt_rad) for name, hw, where in described])


def build(
    configs: Sequence[ArmConfig], keys: Sequence[str], buses: Sequence, pairs: Sequence[BlockPair]
) -> ControlLoop:
    """Build controllers on open buses and inspect them: what can be refused without torque is refused here.

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
