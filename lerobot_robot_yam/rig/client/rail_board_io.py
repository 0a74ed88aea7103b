"""Switches and brake of the virtual rig: a board on a CAN channel of its own, `base_io` for the channel `base`."""

import contextlib
import math
from typing import Any

import can

from lerobot_robot_yam.damiao.handle_encoder import REPORT_ID
from lerobot_robot_yam.rig.devices.board_frames import board_channel, decode_report, encode_request
from lerobot_robot_yam.system.boards.switch_board import BoardSample
from lerobot_robot_yam.system.clock import clock_of


class SimBoard:
    """Driver of the rig's board: each reading asks for the next one, and repeats what the brake shall do.

    Args:
        bus: an open bus, which this object closes.
    """

    def __init__(self, bus: can.BusABC):
        self._bus, self._clock, self._brake_on = bus, clock_of(bus), True
        self._sample = BoardSample(False, False, None, -math.inf)

    def read(self) -> BoardSample:
        with contextlib.suppress(can.CanError, OSError):  # a lost channel shows in the age of the sample
            while (message := self._bus.recv(0.0)) is not None:
                if message.arbitration_id == REPORT_ID:
                    self._sample = BoardSample(*decode_report(bytes(message.data)), message.timestamp)
        self._ask()
        return self._sample

    def set_brake(self, on: bool) -> None:
        if on != self._brake_on:
            self._brake_on = on
            self._ask()

    def _ask(self) -> None:
        with contextlib.suppress(can.CanError, OSError):
            self._bus.send(encode_request(self._brake_on))

    def close(self) -> None:
        self._bus.shutdown()


def open_board(interface: str, base: str, can_options: dict[str, Any]) -> SimBoard:
    """Open the board beside the base's channel. Raises YamError: there is no such rig, or it has no rail."""
    return SimBoard(can.Bus(interface=interface, channel=board_channel(base), **can_options))
