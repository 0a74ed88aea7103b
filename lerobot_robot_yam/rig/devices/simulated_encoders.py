"""The encoders of a simulated leader without motors: a device per joint, and one for trigger and buttons.

Each is a `SimHandle` of its own number, whose angle is that of the arm's joint in the world. They are silent until they
are told to report, or asked.
"""

from collections.abc import Sequence

from lerobot_robot_yam.damiao.passive_encoders import TRIGGER_TRAVEL_RAD
from lerobot_robot_yam.rig.devices.packets import Frame
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.world.world import World


class SimJointEncoder(SimHandle):
    """Of one joint."""

    def __init__(self, world: World, device: int, position: int, velocity: int, sign: int):
        super().__init__(device)
        self._world, self._q, self._dq, self._sign = world, position, velocity, sign

    def _position_rad(self) -> float:
        return self._sign * self._world.qpos[self._q] - self._zero_rad

    def _rate_rad_s(self) -> float:
        return self._sign * self._world.qvel[self._dq]


class SimEncoders(SimHandle):
    """All of one leader, in the place of its handle: trigger and buttons are those of the last device.

    Attributes:
        silent_devices: those that say nothing, from 0.
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

    def requests(self, data: bytes) -> list[Frame]:
        """Answers of all devices to a frame to 0x50E."""
        answers = [device.request(data) for device in self._speaking()]
        return [answer for answer in answers if answer is not None]

    def due_reports(self, now_s: float) -> list[Frame]:
        """Reports that are due unasked."""
        reports = [device.due_report(now_s) for device in self._speaking()]
        return [report for report in reports if report is not None]

    def _speaking(self) -> list[SimHandle]:
        if self.silent:
            return []
        devices: list[SimHandle] = [*self.joints, self]
        return [device for index, device in enumerate(devices) if index not in self.silent_devices]
