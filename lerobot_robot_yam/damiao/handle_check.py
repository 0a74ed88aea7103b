"""Before the loop asks a teaching handle: is one there, is its firmware new enough, does it wait to be asked?

Steps and limits: I2RT encoder driver v1.2.4.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import can

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message, is_classic_data
from lerobot_robot_yam.damiao.encoder import (
    EEPROM_REPORT_FREQUENCY_HIGH,
    EEPROM_REPORT_FREQUENCY_LOW,
    FIRMWARE_REQUIRED,
    REQUEST_ID,
    decode_eeprom_byte,
    decode_report_frequency,
    decode_version,
    encode_eeprom_read,
    encode_report_frequency,
    encode_version_request,
)
from lerobot_robot_yam.errors import MotorError

logger = logging.getLogger(__name__)

_ATTEMPTS = 3
_SILENCE_S = 0.1  # after a change of the report frequency, wait for so long without a frame
_SILENCE_LIMIT_S = 3.0


@dataclass(frozen=True)
class HandleInfo:
    """Firmware version and report frequency that the handle was found with."""

    firmware: tuple[int, int, int]
    report_frequency_hz: int


def prepare_handle(bus: can.BusABC, channel: str, timeout_s: float = 0.1) -> HandleInfo:
    """Find the handle and make it report on request only. Waits up to three times `timeout_s` per question.

    Raises:
        MotorError: no handle answers, its firmware is too old, or it goes on reporting by itself.
        BusError: the channel is gone.
    """
    port = BusPort(bus, channel)
    firmware = _ask(port, encode_version_request(), decode_version, "its firmware version", timeout_s)
    if firmware < FIRMWARE_REQUIRED:
        raise MotorError(
            f"{channel}: the teaching handle has firmware {_dotted(firmware)}; "
            f"update it to {_dotted(FIRMWARE_REQUIRED)} or later with the vendor's tool"
        )
    low = _ask(
        port,
        encode_eeprom_read(EEPROM_REPORT_FREQUENCY_LOW),
        decode_eeprom_byte,
        "its report frequency",
        timeout_s,
    )
    high = _ask(
        port,
        encode_eeprom_read(EEPROM_REPORT_FREQUENCY_HIGH),
        decode_eeprom_byte,
        "its report frequency",
        timeout_s,
    )
    frequency_hz = decode_report_frequency(low, high)
    if frequency_hz:
        logger.warning(
            "%s: the teaching handle reported by itself at %d Hz; set to report on request",
            channel,
            frequency_hz,
        )
        port.send([data_message(REQUEST_ID, encode_report_frequency(0))])
        _wait_for_silence(port)
    return HandleInfo(firmware, frequency_hz)


def _ask[T](port: BusPort, request: bytes, decode: Callable[[bytes], T | None], what: str, timeout_s: float) -> T:
    for _ in range(_ATTEMPTS):
        while port.recv(0.0) is not None:
            pass  # earlier answers do not repeat what they answer, so none may be left
        port.send([data_message(REQUEST_ID, request)])
        deadline = port.clock.now() + timeout_s
        while (remaining := deadline - port.clock.now()) > 0.0:
            message = port.recv(remaining)
            if message is not None and message.arbitration_id == REQUEST_ID and is_classic_data(message):
                answer = decode(bytes(message.data))
                if answer is not None:
                    return answer
    raise MotorError(
        f"{port.channel}: the teaching handle did not tell {what}; check that one is fitted and its cable, "
        "or choose a gripper profile without a handle"
    )


def _wait_for_silence(port: BusPort) -> None:
    deadline = port.clock.now() + _SILENCE_LIMIT_S
    while port.clock.now() < deadline:
        if port.recv(_SILENCE_S) is None:
            return
    raise MotorError(f"{port.channel}: the teaching handle goes on reporting by itself; power-cycle it")


def _dotted(version: tuple[int, int, int]) -> str:
    return ".".join(map(str, version))
