"""Switches and brake of the virtual rig: a board on a CAN channel of its own, `base_io` for the channel `base`."""

import contextlib
import math

import can

from lerobot_robot_yam.damiao.handle_encoder import REPORT_ID
from lerobot_robot_yam.mobile.rail_io import RailSample
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.rig.devices.board_frames import board_channel, decode_report, encode_request
from lerobot_robot_yam.system.clock import clock_of


class SimIo:
    """Driver of the rig's board: each reading asks for the next one, and repeats what the brake shall do.

    Args:
        bus: an open bus, which this object closes.
    """

    def __init__(self, bus: can.BusABC):
        self._bus, self._clock, self._brake_on = bus, clock_of(bus), True
        self._sample = RailSample(False, False, None, -math.inf)

    def read(self) -> RailSample:
        with contextlib.suppress(can.CanError, OSError):  # a lost channel shows in the age of the sample
            while (message := self._bus.recv(0.0)) is not None:
                if message.arbitration_id == REPORT_ID:
                    self._sample = RailSample(*decode_report(bytes(message.data)), message.timestamp)
            self._bus.send(encode_request(self._brake_on))
        return self._sample

    def set_brake(self, on: bool) -> None:
        self._brake_on = on

    def close(self) -> None:
        self._bus.shutdown()


def open_driver(hardware: ResolvedBase) -> SimIo:
    """Open the board that belongs to the base's channel. Raises YamError: there is no rig, or it has no rail."""
    config = hardware.config
    return SimIo(can.Bus(interface=config.interface, channel=board_channel(config.channel), **config.can_options))
