"""Opens an arm's CAN channel; error messages say what to check."""

import contextlib
import importlib
import logging
from collections.abc import Sequence

import can
import can.interfaces

from lerobot_robot_yam.arm.config import SOCKETCAN, VIRTUAL, ChannelConfig
from lerobot_robot_yam.damiao.bus_port import RESET_LINK
from lerobot_robot_yam.damiao.tables import BITRATE
from lerobot_robot_yam.errors import BusError, YamError

logger = logging.getLogger(__name__)

# LeRobot's commands set the root logger to NOTSET; python-can would then log each received frame.
logging.getLogger("can.bus").setLevel(logging.INFO)

_ID_MASK = 0x7FF
_KNOWN = (SOCKETCAN, VIRTUAL, "yam_lockstep")


def load_driver(interface: str) -> None:
    """Import python-can's module for an interface ahead of `open_bus`, since the first import takes 50 ms."""
    if interface in can.interfaces.BACKENDS:
        with contextlib.suppress(ImportError):  # `open_bus` reports the missing module
            importlib.import_module(can.interfaces.BACKENDS[interface][0])


def open_bus(config: ChannelConfig, only: Sequence[int] | None = None) -> can.BusABC:
    """Open the arm's channel, classic CAN at 1 Mbit/s.

    Args:
        config: the arm.
        only: CAN ids to receive; None: all.

    Raises:
        BusError: interface or channel is unknown, or cannot be opened.
    """
    if config.interface not in _KNOWN:
        what = "%s: python-can's %r has been tried with no arm: some interfaces take seconds to open, and no stand-by "
        what += "can then land an arm in time, or have clocks that drift; the kernel's (socketcan) is the one to use"
        logger.warning(what, config.name, config.interface)
    filters = None if only is None else [{"can_id": i, "can_mask": _ID_MASK, "extended": False} for i in only]
    try:
        return can.Bus(
            interface=config.interface,
            channel=config.channel,
            can_filters=filters,
            ignore_config=True,  # ignores python-can's own configuration files
            **{"bitrate": BITRATE, **config.can_options},
        )
    except YamError:
        raise
    except Exception as error:  # interfaces also raise what their own libraries raise
        if isinstance(error, NotImplementedError):
            advice = f"take {SOCKETCAN}, or {VIRTUAL} for the virtual rig"
        elif config.interface == SOCKETCAN:
            advice = (
                "is the adapter plugged in (yam-setup-can --list), and the link up? "
                f"{RESET_LINK} {config.channel} brings it up"
            )
        else:
            advice = "is the adapter plugged in, and is that what the interface calls it?"
        raise BusError(
            f"{config.name}: cannot open CAN channel {config.channel!r} through interface {config.interface!r}: "
            f"{error}; {advice}"
        ) from error


def close_bus(bus: can.BusABC) -> None:
    """Close a channel. An error of an interface that is gone is logged: it must not keep other channels open."""
    try:
        bus.shutdown()
    except Exception as error:
        logger.warning("%s: closing failed: %r", bus.channel_info, error)
