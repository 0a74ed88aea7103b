"""Simulated encoders on a leader's bus: those of a teaching handle, and those of a leader without motors.

The encoders behave like firmware 2.4.0, set to report on request, as far as the driver uses it: they send no events.
Unlike real encoders, they preserve the order of replies to overlapping requests.
"""

from collections.abc import Sequence

from lerobot_robot_yam.damiao import handle_encoder as encoder
from lerobot_robot_yam.damiao.passive_encoders import TRIGGER_TRAVEL_RAD
from lerobot_robot_yam.rig.devices.packets import Frame
from lerobot_robot_yam.rig.world.world import World

FIRMWARE = (2, 4, 0)
_DEVICE = 1


class SimHandle:
    """Trigger and two buttons, moved by the operator or a test; replies to requests on 0x50E.

    device: number of the handle in requests and replies.
    """

    travel_rad = encoder.TRIGGER_TRAVEL_RAD

    def __init__(self, device: int = _DEVICE) -> None:
        self._device = device
        self.trigger = 0.0  # 0 released … 1 squeezed
        self.trigger_rate = 0.0  # 1/s
        self.buttons = (False, False)
        self.silent = False
        self.report_period_s = 0.0  # 0: reports on request only
        self._zero_rad = 0.0
        self._next_report_s = 0.0
        self._eeprom = bytearray(encoder.EEPROM_BYTES)
        self._eeprom[7] = self._device
        self._eeprom[encoder.EEPROM_ADC_FREQUENCY_LOW] = encoder.ADC_FREQUENCY

    def requests(self, data: bytes) -> list[Frame]:
        """Return the replies of all devices that are not silent to a frame with identifier 0x50E."""
        return [answer for device in self._speaking() if (answer := device.request(data)) is not None]

    def due_reports(self, now_s: float) -> list[Frame]:
        """Return the due periodic reports of all devices that are not silent."""
        return [report for device in self._speaking() if (report := device.due_report(now_s)) is not None]

    def _speaking(self) -> "list[SimHandle]":
        return [self]

    def request(self, data: bytes) -> Frame | None:
        """Reply to a frame with identifier 0x50E; return None for settings and unknown requests."""
        if self.silent or len(data) < 2 or data[0] not in (self._device, encoder.ALL_DEVICES):
            return None
        opcode, parameters = data[1], data[2:]
        answer: bytes | None = None
        if opcode == encoder.OP_REPORT:
            return self.report()
        if opcode == encoder.OP_VERSION:
            answer = encoder.encode_version(FIRMWARE, self._device)
        elif opcode == encoder.OP_READ_EEPROM and parameters and parameters[0] < len(self._eeprom):
            answer = encoder.encode_eeprom_byte(self._eeprom[parameters[0]], self._device)
        elif opcode == encoder.OP_SET_ZERO:
            self._zero_rad += self._position_rad()
            counts = round(self._zero_rad / encoder.RAD_PER_COUNT) & 0xFFFF
            self._eeprom[encoder.EEPROM_ZERO_HIGH], self._eeprom[encoder.EEPROM_ZERO_LOW] = divmod(counts, 0x100)
        elif opcode == encoder.OP_SET_REPORT_FREQUENCY and parameters:
            self.set_report_frequency(int.from_bytes(parameters[:2], "big"))
        elif opcode == encoder.OP_SET_ADC_FREQUENCY and parameters:
            high, low = int.from_bytes(parameters[:2], "big").to_bytes(2, "big")
            self._eeprom[encoder.EEPROM_ADC_FREQUENCY_HIGH] = high
            self._eeprom[encoder.EEPROM_ADC_FREQUENCY_LOW] = low
        return None if answer is None else Frame(0.0, encoder.REQUEST_ID, answer)

    def set_report_frequency(self, hz: int) -> None:
        """Set the rate of unsolicited reports; 0 for none."""
        hz = min(hz, encoder.REPORT_FREQUENCY_MAX_HZ)
        self.report_period_s = 1.0 / hz if hz else 0.0
        self._eeprom[encoder.EEPROM_REPORT_FREQUENCY_LOW] = hz & 0xFF
        self._eeprom[encoder.EEPROM_REPORT_FREQUENCY_HIGH] = hz >> 8

    def due_report(self, now_s: float) -> Frame | None:
        """Return the periodic report if it is due, else None."""
        if self.report_period_s == 0.0 or now_s < self._next_report_s or self.silent:
            return None
        self._next_report_s = max(self._next_report_s + self.report_period_s, now_s)
        return self.report()

    def report(self) -> Frame:
        """Encode the current state as a report."""
        data = encoder.encode_report(self._position_rad(), self._rate_rad_s(), self.buttons, self._device)
        return Frame(0.0, encoder.REPORT_ID, data)

    def _position_rad(self) -> float:
        return self.trigger * self.travel_rad - self._zero_rad

    def _rate_rad_s(self) -> float:
        return self.trigger_rate * self.travel_rad


class SimJointEncoder(SimHandle):
    """Encoder with its own device number that reports the angle of one of the arm's joints in the world."""

    def __init__(self, world: World, device: int, position: int, velocity: int, sign: int):
        super().__init__(device)
        self._world, self._q, self._dq, self._sign = world, position, velocity, sign

    def _position_rad(self) -> float:
        return self._sign * self._world.qpos[self._q] - self._zero_rad

    def _rate_rad_s(self) -> float:
        return self._sign * self._world.qvel[self._dq]


class SimEncoders(SimHandle):
    """All encoders of a leader without motors, in place of a handle: one device per joint, the last for the trigger.

    The encoders are silent until they receive a request or their report frequency is set.

    Attributes:
        silent_devices: indices, from 0, of encoders that neither report nor reply.
    """

    travel_rad = TRIGGER_TRAVEL_RAD

    def __init__(self, world: World, channel: str, signs: Sequence[int]):
        super().__init__(len(signs))
        addresses, dofs = world.joint_addresses(channel), world.joint_dofs(channel)
        self.joints = [
            SimJointEncoder(world, device, q, dq, sign)
            for device, (q, dq, sign) in enumerate(zip(addresses, dofs, signs, strict=True))
        ]
        self.silent_devices: frozenset[int] = frozenset()

    def _speaking(self) -> list[SimHandle]:
        if self.silent:
            return []
        devices: list[SimHandle] = [*self.joints, self]
        return [device for index, device in enumerate(devices) if index not in self.silent_devices]
