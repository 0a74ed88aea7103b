"""Encoders of a leader without motors, all on one CAN channel: one device per joint, then one for the trigger.

Each device is of the teaching handle's kind (`handle_encoder`). Device 0 is joint 1; the device after the last joint
reads the trigger and both buttons. Once configured, each device reports 200 times a second without requests.
"""

import math
from collections.abc import Sequence

import can
import numpy as np

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message, is_classic_data
from lerobot_robot_yam.damiao.handle_encoder import (
    EVENT_ID,
    OP_SET_REPORT_FREQUENCY,
    REPORT_ID,
    REQUEST_ID,
    HandleReport,
    decode_report,
)
from lerobot_robot_yam.errors import MotorError

REPORT_HZ = 200
TRIGGER_TRAVEL_RAD = 0.67
READY_TIMEOUT_S = 3.0
_STREAMS_S = 0.1  # time within which a streaming device is sure to have reported, s
_REPORT_BYTES = 6


def encode_stream_request(device: int, hz: int = REPORT_HZ) -> bytes:
    """Encode a request that makes one device report periodically, at up to 255 Hz."""
    return bytes((device, OP_SET_REPORT_FREQUENCY, hz))


class PassiveEncoders:
    """Newest report of each encoder on a channel.

    Attributes:
        angle_rad, rate_rad_s, stamp_s: (joints + 1,) in encoder coordinates, the trigger last; stamp_s is -inf before
            the first report.
        buttons: whether the top button and the second button are pressed.
    """

    def __init__(self, joints: int):
        self.joints = joints
        self.angle_rad = np.zeros(joints + 1)
        self.rate_rad_s = np.zeros(joints + 1)
        self.stamp_s = np.full(joints + 1, -math.inf)
        self.buttons = (False, False)

    def accept(self, message: can.Message, stamp_s: float) -> bool:
        """Process a frame; return False if the frame is not a report from one of these devices."""
        if message.arbitration_id not in (REPORT_ID, EVENT_ID) or not is_classic_data(message):
            return False
        data = bytes(message.data)
        if len(data) != _REPORT_BYTES or data[0] > self.joints:
            return False
        report: HandleReport = decode_report(data)
        device = data[0]
        self.angle_rad[device], self.rate_rad_s[device] = report.position_rad, report.velocity_rad_s
        self.stamp_s[device] = stamp_s
        if device == self.joints:
            self.buttons = report.buttons
        return True

    def collect(self, port: BusPort, until_s: float) -> None:
        """Process all frames that arrive until `until_s` (the port's clock). Raises BusError: the channel is lost."""
        while True:
            message = port.recv(max(0.0, until_s - port.clock.now()))
            if message is None:
                return
            self.accept(message, port.arrival_s(message))

    def silent(self, since_s: float) -> list[str]:
        """Return the names of devices that have not reported since `since_s`."""
        return [self._name(device) for device in np.flatnonzero(self.stamp_s < since_s)]

    def start(self, port: BusPort, name: str) -> None:
        """Make all devices report, and wait for their first reports.

        Raises:
            MotorError: a device stays silent; the message names it.
            BusError: the channel is lost.
        """
        clock = port.clock
        begin = clock.now()
        self.collect(port, begin + _STREAMS_S)
        quiet = np.flatnonzero(self.stamp_s < begin).tolist()
        self._ask(port, quiet)
        while missing := self.silent(begin):
            if clock.now() > begin + READY_TIMEOUT_S:
                raise MotorError(
                    f"{name} ({port.channel}): no report from {', '.join(missing)} within {READY_TIMEOUT_S:g} s; check "
                    "power and cable of the passive leader, and that this is its channel"
                )
            self.collect(port, clock.now() + _STREAMS_S)

    @staticmethod
    def _ask(port: BusPort, devices: Sequence[int]) -> None:
        """Enable reporting, stored in EEPROM, on these devices. Streaming devices are skipped, to spare the EEPROM."""
        if devices:
            port.send([data_message(REQUEST_ID, encode_stream_request(device)) for device in devices])

    def _name(self, device: int) -> str:
        return "the trigger" if device == self.joints else f"joint_{device + 1}"
