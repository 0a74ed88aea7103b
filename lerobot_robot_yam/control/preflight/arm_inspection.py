"""Inspection of a limp arm before bring-up; sends no command that moves or energises a motor."""

import logging

import can

from lerobot_robot_yam.arm.mounting import arm_ids, gripper_id
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.preflight.binding import check_identity
from lerobot_robot_yam.control.preflight.fingerprint import read_fingerprint
from lerobot_robot_yam.control.preflight.role import carries_base, mistaken_role
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.handle_check import prepare_handle
from lerobot_robot_yam.damiao.motor_inspection import LISTEN_S, check_bandwidth, listen, verify
from lerobot_robot_yam.damiao.tables import fault_text
from lerobot_robot_yam.errors import EmergencyStopError, MotorError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

_ATTEMPTS = 5


def refuse_stopped(name: str, stop: EmergencyStop) -> None:
    """Check that arms may be energised. Raises EmergencyStopError: the emergency stop is latched."""
    sources = stop.sources()
    if sources:
        raise EmergencyStopError(
            f"{name}: the emergency stop is latched: {'; '.join(sources.values())}. Look at the arms, then "
            f"`yam-estop release {' '.join(sources)}`"
        )


def inspect(hardware: ResolvedArm, chain: MotorChain, bus: can.BusABC) -> None:
    """Check that all parts reply and match the configuration, without another driver on the channel.

    Raises:
        YamError: a part is missing or differs from the configuration, or another driver is active.
    """
    config = hardware.config
    refuse_stopped(config.name, EmergencyStop())
    handle = hardware.gripper.handle_encoder
    check_bandwidth(len(chain), handle, config.rate_hz)
    if not config.skip_listen:
        listen(bus, LISTEN_S, [m.can_id for m in chain.motors], config.channel)
    if config.identity_path is not None:
        found = read_fingerprint(bus, config.channel, config.interface, arm_ids(hardware.arm))
        if found.motors:  # else `verify` raises with a better message
            check_identity(config.identity_path, found, config.channel, config.name, config.on_command_line)
    role = bus, config.channel, config.name, hardware.gripper, gripper_id(hardware.arm)
    try:
        verify(chain)
        if handle:
            prepare_handle(bus, config.channel)
    except MotorError as error:
        if hardware.joints and carries_base(bus, config.channel):
            what = f"{config.name}: channel {config.channel} carries a mobile base: are cables or channels swapped?"
            raise MotorError(what) from error
        swap = mistaken_role(*role)
        if swap is None:
            raise
        raise MotorError(f"{swap} ({error})") from error
    if not handle and hardware.gripper.motor is None:  # the wrong arm would not lack any part
        swap = mistaken_role(*role)
        if swap is not None:
            raise MotorError(swap)
    for _ in range(_ATTEMPTS):
        answered = chain.refresh()
        if all(answered):
            return
    silent = [m.name for m, heard in zip(chain.motors, answered, strict=True) if not heard]
    raise MotorError(
        f"{config.name} ({config.channel}): no feedback from {', '.join(silent)}, though registers are answered; "
        "check the cable and the motor's MST_ID (yam-doctor)"
    )


def clear_stale_faults(name: str, chain: MotorChain) -> None:
    """Log and clear motor faults left by an earlier session, since operators re-arm by connecting again."""
    stale = {m.name: fault_text(f) for m, f in zip(chain.motors, chain.fault.tolist(), strict=True) if f > 1}
    if stale:
        logger.warning("%s: clearing what an earlier session left behind: %s", name, stale)
        chain.special(SpecialCommand.CLEAR)
