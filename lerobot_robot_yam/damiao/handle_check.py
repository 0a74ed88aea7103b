"""Checks of a teaching handle before the loop: is it present, is its firmware new enough, does it report on request?

Source of steps and limits: I2RT encoder driver v1.2.4.
"""

import logging
from collections.abc import Callable

import can

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message, is_classic_data
from lerobot_robot_yam.damiao.handle_encoder import (
    ADC_FREQUENCY,
    EEPROM_ADC_FREQUENCY_HIGH,
    EEPROM_ADC_FREQUENCY_LOW,
    EEPROM_REPORT_FREQUENCY_HIGH,
    EEPROM_REPORT_FREQUENCY_LOW,
    FIRMWARE_FAST_ADC,
    FIRMWARE_REQUIRED,
    HANDLE_IDS,
    REQUEST_ID,
    decode_eeprom_byte,
    decode_frequency,
    decode_version,
    encode_adc_frequency,
    encode_eeprom_read,
    encode_report_frequency,
    encode_version_request,
)
from lerobot_robot_yam.errors import MotorError

logger = logging.getLogger(__name__)

_ATTEMPTS = 3
_SILENCE_S = 0.1  # silence that confirms a change of the report frequency, s
_SILENCE_LIMIT_S = 3.0


def prepare_handle(bus: can.BusABC, channel: str, timeout_s: float = 0.1) -> tuple[tuple[int, int, int], int]:
    """Find the handle, make it report on request only and, if its firmware is old, sample as fast as possible.

    Waits up to three times `timeout_s` per request. Return the firmware version, and the report frequency (Hz) that
    was set before.

    Raises:
        MotorError: no handle replies, its firmware is too old, or it continues to report without requests.
        BusError: the channel is lost.
    """
    port = BusPort(bus, channel)
    firmware = _told(port, encode_version_request(), decode_version, "its firmware version", timeout_s)
    if firmware < FIRMWARE_REQUIRED:
        raise MotorError(
            f"{channel}: the teaching handle has firmware {_dotted(firmware)}; "
            f"update it to {_dotted(FIRMWARE_REQUIRED)} or later with the vendor's tool"
        )
    changed = False
    if firmware < FIRMWARE_FAST_ADC:
        sampled = _frequency(port, EEPROM_ADC_FREQUENCY_LOW, EEPROM_ADC_FREQUENCY_HIGH, "ADC frequency", timeout_s)
        if sampled != ADC_FREQUENCY:
            logger.warning("%s: the teaching handle had ADC frequency %d; set to %d", channel, sampled, ADC_FREQUENCY)
            port.send([data_message(REQUEST_ID, encode_adc_frequency(ADC_FREQUENCY))])
            changed = True
    low, high = EEPROM_REPORT_FREQUENCY_LOW, EEPROM_REPORT_FREQUENCY_HIGH
    frequency_hz = _frequency(port, low, high, "report frequency", timeout_s)
    if frequency_hz:
        logger.warning(
            "%s: the teaching handle reported by itself at %d Hz; set to report on request", channel, frequency_hz
        )
        port.send([data_message(REQUEST_ID, encode_report_frequency(0))])
        changed = True
    if changed:
        _wait_for_silence(port)
    return firmware, frequency_hz


def _frequency(port: BusPort, low: int, high: int, what: str, timeout_s: float) -> int:
    """Read a frequency, which takes two bytes of the EEPROM."""
    values = [_told(port, encode_eeprom_read(at), decode_eeprom_byte, f"its {what}", timeout_s) for at in (low, high)]
    return decode_frequency(*values)


def handle_firmware(bus: can.BusABC, channel: str, timeout_s: float = 0.03) -> tuple[int, int, int] | None:
    """Read the handle's firmware version; None if no handle replies. Raises BusError: the channel is lost."""
    return ask_handle(BusPort(bus, channel), encode_version_request(), decode_version, timeout_s)


def _told[T](port: BusPort, request: bytes, decode: Callable[[bytes], T | None], what: str, timeout_s: float) -> T:
    answer = ask_handle(port, request, decode, timeout_s)
    if answer is None:
        raise MotorError(
            f"{port.channel}: the teaching handle did not tell {what}; check that one is fitted and its cable, "
            "or choose a gripper profile without a handle"
        )
    return answer


def ask_handle[T](
    port: BusPort, request: bytes, decode: Callable[[bytes], T | None], timeout_s: float, identifier: int = REQUEST_ID
) -> T | None:
    """Send a request up to three times; return the handle's decoded reply with this CAN id, or None."""
    for _ in range(_ATTEMPTS):
        while port.recv(0.0) is not None:
            pass  # drop earlier replies, which do not state their request
        port.send([data_message(REQUEST_ID, request)])
        deadline = port.clock.now() + timeout_s
        while (remaining := deadline - port.clock.now()) > 0.0:
            message = port.recv(remaining)
            if message is not None and message.arbitration_id == identifier and is_classic_data(message):
                answer = decode(bytes(message.data))
                if answer is not None:
                    return answer
    return None


def _wait_for_silence(port: BusPort) -> None:
    """Wait until no frame of the handle has arrived for `_SILENCE_S`; other devices may send."""
    begin = heard = port.clock.now()
    while (now := port.clock.now()) < begin + _SILENCE_LIMIT_S:
        if now >= heard + _SILENCE_S:
            return
        message = port.recv(heard + _SILENCE_S - now)
        if message is not None and message.arbitration_id in HANDLE_IDS and is_classic_data(message):
            heard = port.clock.now()
    raise MotorError(f"{port.channel}: the teaching handle goes on reporting by itself; power-cycle it")


def _dotted(version: tuple[int, int, int]) -> str:
    return ".".join(map(str, version))
