"""Teaching-handle encoder on a leader's CAN bus: trigger angle and two buttons.

Requests are sent to 0x50E as (device, opcode, parameters); device 0xFF addresses all. A report has id 0x50F, an event
(button edge) id 0x510, both with the layout
    device, position int16, velocity int16 (big-endian, 4096 counts per turn), digital inputs
Source: I2RT encoder driver and reader v1.2.4.
"""

import math
import struct
from typing import NamedTuple

from lerobot_robot_yam.errors import BusError

REQUEST_ID = 0x50E
REPORT_ID = 0x50F
EVENT_ID = 0x510
JOYSTICK_ID = 0x511
HANDLE_IDS = frozenset((REQUEST_ID, REPORT_ID, EVENT_ID, JOYSTICK_ID))

ALL_DEVICES = 0xFF
OP_SET_ZERO = 0x00
OP_SET_REPORT_FREQUENCY = 0x01
OP_REPORT = 0x02
OP_VERSION = 0x03
OP_SET_ADC_FREQUENCY = 0x04
OP_READ_EEPROM = 0x07
OP_WRITE_EEPROM = 0x10
REPLY_FLAG = 0x80  # set in the opcode of configuration replies

EEPROM_ADC_FREQUENCY_LOW = 8
EEPROM_ZERO_HIGH = 9
EEPROM_ZERO_LOW = 10
EEPROM_ADC_FREQUENCY_HIGH = 27
EEPROM_REPORT_FREQUENCY_LOW = 25
EEPROM_REPORT_FREQUENCY_HIGH = 28
EEPROM_BYTES = 31
REPORT_FREQUENCY_MAX_HZ = 600
FIRMWARE_REQUIRED = (2, 2, 12)
FIRMWARE_FAST_ADC = (2, 4, 0)  # first version that always runs the ADC at its maximum rate
ADC_FREQUENCY = 255  # setting for older versions: the maximum rate

RAD_PER_COUNT = 2 * math.pi / 4096
TRIGGER_TRAVEL_RAD = 0.7

_REPORT = struct.Struct(">BhhB")


class HandleReport(NamedTuple):
    """Trigger position (rad), velocity (rad/s), buttons (SYNC, RECORD), trigger from 0 (released) to 1 (squeezed)."""

    position_rad: float
    velocity_rad_s: float
    buttons: tuple[bool, bool]
    trigger: float


def encode_report_request() -> bytes:
    """Encode a request for one report, two bytes for CAN id 0x50E."""
    return bytes((ALL_DEVICES, OP_REPORT))


def encode_version_request() -> bytes:
    """Encode a request for the firmware version."""
    return bytes((ALL_DEVICES, OP_VERSION))


def encode_eeprom_read(offset: int) -> bytes:
    """Encode a request for one EEPROM byte, offset 0 … 30."""
    return bytes((ALL_DEVICES, OP_READ_EEPROM, offset))


def encode_zero() -> bytes:
    """Encode a command that makes the trigger's current position zero. The device does not acknowledge it."""
    return bytes((ALL_DEVICES, OP_SET_ZERO))


def encode_report_frequency(hz: int) -> bytes:
    """Encode a report frequency, 0 … 600 Hz; 0: only on request. The device does not acknowledge the setting."""
    if hz <= 0xFF:
        return bytes((ALL_DEVICES, OP_SET_REPORT_FREQUENCY, hz))
    return bytes((ALL_DEVICES, OP_SET_REPORT_FREQUENCY, hz >> 8, hz & 0xFF))


def encode_adc_frequency(frequency: int) -> bytes:
    """Encode the trigger's sampling frequency (0 … 255, device unit). The device does not acknowledge the setting."""
    return bytes((ALL_DEVICES, OP_SET_ADC_FREQUENCY, frequency))


def decode_report(data: bytes) -> HandleReport:
    """Decode a report or event (6 bytes).

    The second button is the second input bit alone: a third input must not change it.

    Raises:
        BusError: `data` is not 6 bytes long.
    """
    if len(data) != _REPORT.size:
        raise BusError(f"a handle's report has {_REPORT.size} bytes, not {len(data)}: {bytes(data).hex(' ')}")
    _, position, velocity, inputs = _REPORT.unpack(data)
    position_rad = position * RAD_PER_COUNT
    return HandleReport(
        position_rad,
        velocity * RAD_PER_COUNT,
        (inputs & 1 != 0, inputs & 2 != 0),
        min(abs(position_rad), TRIGGER_TRAVEL_RAD) / TRIGGER_TRAVEL_RAD,
    )


def encode_report(position_rad: float, velocity_rad_s: float, buttons: tuple[bool, bool], device: int = 1) -> bytes:
    """Encode a report as the device does, 6 bytes; values beyond int16 counts saturate."""
    return _REPORT.pack(
        device, _counts(position_rad), _counts(velocity_rad_s), (1 if buttons[0] else 0) | (2 if buttons[1] else 0)
    )


def encode_version(version: tuple[int, int, int], device: int = 1) -> bytes:
    """Encode the device's reply to a version request, sent on CAN id 0x50E."""
    return bytes((device, OP_VERSION | REPLY_FLAG, *version))


def decode_version(data: bytes) -> tuple[int, int, int] | None:
    """Decode the firmware version (major, minor, patch); return None if the frame is another reply."""
    if len(data) < 5 or data[1] != OP_VERSION | REPLY_FLAG:
        return None
    return data[2], data[3], data[4]


def encode_eeprom_byte(value: int, device: int = 1) -> bytes:
    """Encode the device's reply to an EEPROM read, sent on CAN id 0x50E."""
    return bytes((device, OP_READ_EEPROM | REPLY_FLAG, value))


def decode_eeprom_byte(data: bytes) -> int | None:
    """Decode the EEPROM byte in a reply; return None if the frame is another reply."""
    if len(data) < 3 or data[1] != OP_READ_EEPROM | REPLY_FLAG:
        return None
    return data[2]


def decode_frequency(low: int, high: int) -> int:
    """Decode a report frequency (Hz) or ADC frequency from two EEPROM bytes; a high byte of 0xFF means: not set."""
    return low if high == 0xFF else high << 8 | low


def _counts(radians: float) -> int:
    return min(max(round(radians / RAD_PER_COUNT), -0x8000), 0x7FFF)


class HandleEncoder:
    """Newest report of the handle, its timestamp and the number of lost reports."""

    def __init__(self) -> None:
        self.report = HandleReport(0.0, 0.0, (False, False), 0.0)
        self.stamp_s = -math.inf  # time of receipt (the chain's clock); -inf before the first report
        self.lost = 0

    def accept(self, data: bytes, stamp_s: float) -> bool:
        """Process a report or event; return False if the frame has a wrong length."""
        if len(data) != _REPORT.size:
            return False
        self.report = decode_report(data)
        self.stamp_s = stamp_s
        return True
