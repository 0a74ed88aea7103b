"""Access to a teaching handle on a bus that no program drives: its reports, and its settings with verification.

The device acknowledges no setting, so each setting is read back.
"""

import math
from collections.abc import Iterator

import can

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message, is_classic_data
from lerobot_robot_yam.damiao.handle_check import ask_handle
from lerobot_robot_yam.damiao.handle_encoder import (
    EEPROM_REPORT_FREQUENCY_HIGH,
    EEPROM_REPORT_FREQUENCY_LOW,
    REPORT_FREQUENCY_MAX_HZ,
    REPORT_ID,
    REQUEST_ID,
    HandleReport,
    decode_eeprom_byte,
    decode_frequency,
    decode_report,
    decode_version,
    encode_eeprom_read,
    encode_report_frequency,
    encode_report_request,
    encode_version_request,
    encode_zero,
)
from lerobot_robot_yam.errors import ConfigError, MotorError

_ANSWER_S = 0.1
_SETTING_S = 0.1  # time that the device needs to write its EEPROM, s
_STILL_S, _STILL_RAD = 0.3, 0.02
ZERO_RAD = 0.01
"""Maximum reading of a released trigger after zeroing, rad: half a degree."""


class HandleAccess:
    """Access to the only handle on a channel.

    Raises (every method):
        BusError: the channel is lost.

    Args:
        bus: open bus that no other program drives.
        channel: the channel's name, for messages.
    """

    def __init__(self, bus: can.BusABC, channel: str):
        self.channel = channel
        self._port = BusPort(bus, channel)
        self.clock = self._port.clock

    def firmware(self) -> tuple[int, int, int]:
        """Read the firmware version of the only handle.

        Raises:
            MotorError: no handle replies, or several devices do, as on a leader without motors.
        """
        version = ask_handle(self._port, encode_version_request(), decode_version, _ANSWER_S)
        if version is None:
            raise MotorError(
                f"{self.channel}: no teaching handle answers; check that this is a leader, its power and the handle's "
                "cable (yam-identify tells what is on the channel)"
            )
        devices = self.devices()
        if len(devices) > 1:
            raise MotorError(
                f"{self.channel}: {len(devices)} encoders answer ({', '.join(map(str, devices))}): this is a leader "
                "without motors, or two handles share the bus; nothing was changed"
            )
        return version

    def devices(self) -> list[int]:
        """Return the numbers of the encoders that reply: one for a handle, several for a leader without motors."""
        self._send(encode_version_request())
        return sorted({data[0] for data in self._frames(REQUEST_ID, _ANSWER_S) if decode_version(data)})

    def report(self) -> HandleReport:
        """Read trigger and buttons. Raises MotorError: the handle sends no report."""
        request = encode_report_request()
        report = ask_handle(self._port, request, _report, _ANSWER_S, REPORT_ID)
        if report is None:
            raise MotorError(f"{self.channel}: the teaching handle does not report its trigger; check its cable")
        return report

    def eeprom(self, offset: int) -> int:
        """Read one byte of the handle's EEPROM. Raises MotorError: the handle does not reply."""
        value = ask_handle(self._port, encode_eeprom_read(offset), decode_eeprom_byte, _ANSWER_S)
        if value is None:
            raise MotorError(f"{self.channel}: the teaching handle does not tell EEPROM byte {offset}")
        return value

    def report_frequency(self) -> int:
        """Read the frequency at which the handle reports without requests, Hz; 0: only on request."""
        return decode_frequency(self.eeprom(EEPROM_REPORT_FREQUENCY_LOW), self.eeprom(EEPROM_REPORT_FREQUENCY_HIGH))

    def set_report_frequency(self, hz: int) -> None:
        """Set the report frequency, unless it is already set, and verify it.

        Raises:
            ConfigError: the frequency is outside 0 … 600 Hz.
            MotorError: the handle reports another frequency afterwards.
        """
        if not 0 <= hz <= REPORT_FREQUENCY_MAX_HZ:
            raise ConfigError(f"a handle reports 0 to {REPORT_FREQUENCY_MAX_HZ} times a second, not {hz}")
        if self.report_frequency() == hz:
            return
        self._send(encode_report_frequency(hz))
        self.clock.sleep(_SETTING_S)
        found = self.report_frequency()
        if found != hz:
            raise MotorError(
                f"{self.channel}: the teaching handle reports {found} times a second, not {hz}; switch the arm's power "
                "off and on, and try again"
            )

    def set_zero(self) -> None:
        """Make the trigger's current position zero; the trigger must be released and still.

        Raises:
            MotorError: the trigger moves, or does not read 0 afterwards.
        """
        deadline, seen = self.clock.now() + _STILL_S, [self.report().position_rad]
        while self.clock.now() < deadline:
            seen.append(self.report().position_rad)
            self.clock.sleep(0.01)
        if max(seen) - min(seen) > _STILL_RAD:
            raise MotorError(
                f"{self.channel}: the trigger moved by {max(seen) - min(seen):.3f} rad within {_STILL_S} s; its zero "
                "was left as it is. Let go of it, and try again"
            )
        self._send(encode_zero())
        self.clock.sleep(_SETTING_S)
        position = self.report().position_rad
        if not math.isclose(position, 0.0, abs_tol=ZERO_RAD):
            raise MotorError(
                f"{self.channel}: the trigger reads {position:+.3f} rad after its zero was set; let go of it, and try "
                "again"
            )

    def _frames(self, identifier: int, seconds: float) -> Iterator[bytes]:
        deadline = self.clock.now() + seconds
        while (remaining := deadline - self.clock.now()) > 0.0:
            message = self._port.recv(remaining)
            if message is not None and message.arbitration_id == identifier and is_classic_data(message):
                yield bytes(message.data)

    def _send(self, data: bytes) -> None:
        self._port.send([data_message(REQUEST_ID, data)])


def _report(data: bytes) -> HandleReport | None:
    return decode_report(data) if len(data) == 6 else None
