"""Opening an arm's CAN channel, with errors that say what to check."""

import can

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import BusError, YamError

_BITRATE = 1_000_000


def open_bus(config: ArmConfig) -> can.BusABC:
    """Open the arm's channel, classic CAN at 1 Mbit/s.

    Raises:
        BusError: unknown interface or channel, or it cannot be opened.
    """
    try:
        return can.Bus(
            interface=config.interface, channel=config.channel, **{"bitrate": _BITRATE, **config.can_options}
        )
    except YamError:
        raise
    except (can.CanError, OSError, ValueError, TypeError, NotImplementedError) as error:
        raise BusError(
            f"{config.name}: cannot open CAN channel {config.channel!r} through interface {config.interface!r}: "
            f"{error}; is the adapter plugged in and the link up? "
            f"(ip link set {config.channel} up type can bitrate {_BITRATE})"
        ) from error
