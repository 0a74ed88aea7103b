"""Joint-space interface to the motors and the teaching handle of one arm: inspect, enable, send and receive."""

import logging
from collections.abc import Sequence
from pathlib import Path

import can
import numpy as np

from lerobot_robot_yam.arm.joint_map import JointMap, resolve_turn
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.gripper.gripper import Gripper
from lerobot_robot_yam.control.gripper.handle_reader import HandleReader
from lerobot_robot_yam.control.gripper.trigger_range import TriggerRange, load_range
from lerobot_robot_yam.control.joints.estimate import JointEstimate
from lerobot_robot_yam.control.preflight import arm_inspection
from lerobot_robot_yam.control.safety.thermal_monitor import ThermalMonitor, trips_c
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder
from lerobot_robot_yam.damiao.plausibility import PERIOD_S
from lerobot_robot_yam.damiao.registers import Register

logger = logging.getLogger(__name__)

_LOST = 100  # number of lost replies that are worth a warning: all motors of an arm for 60 ms


class JointInterface:
    """The n motors of one channel in joint coordinates, the gripper last.

    Args:
        hardware: the arm.
        bus: an open bus; the caller closes it.

    Attributes:
        estimate: measured joint state.
        sent: (n, 5) commands sent last.
        handle: the teaching handle, or None without one.
        instead: motor index -> special command that replaces the motor's next command.
    """

    def __init__(self, hardware: ResolvedArm, bus: can.BusABC):
        self._hardware, self._bus = hardware, bus
        self._config = config = hardware.config
        hw, n = hardware, hardware.n
        self._encoder = HandleEncoder() if hw.gripper.handle_encoder else None
        period_s = 1.0 / config.rate_hz if config.rate_hz else PERIOD_S
        self.chain = MotorChain(bus, hw.motors, channel=config.channel, encoder=self._encoder, period_s=period_s)
        self.gripper = None
        if hw.has_gripper:
            self.gripper = Gripper(config, hw.gripper, float(hw.kp[-1]), float(hw.kd[-1]))
        self._map = JointMap(hw.direction, np.zeros(n))
        self.estimate = JointEstimate(hw, self.chain, self._map, self.gripper)
        self.heat: ThermalMonitor | None = None  # created by `inspect`
        self.sent = np.zeros((n, 5))
        self.instead: dict[int, SpecialCommand] = {}
        self.handle: HandleReader | None = None
        if self._encoder is not None:
            self.handle = HandleReader(config.name, self._encoder, _trigger_range(hw))

    @property
    def offset_rad(self) -> np.ndarray:
        """Motor angles at joint zero (n,), rad."""
        return self._map.offset_rad

    def position(self, motor_rad: np.ndarray) -> np.ndarray:
        """Convert motor positions (n,) to joint coordinates, rad."""
        return self._map.position(motor_rad)

    def inspect(self) -> None:
        """Check that all parts reply and match the configuration, without moving or energising a motor.

        Raises:
            YamError: a part is missing or differs from the configuration; the message names the part.
        """
        arm_inspection.inspect(self._hardware, self.chain, self._bus)
        self.estimate.read()
        self.resolve(range(self._hardware.joints))
        if self.gripper is not None:
            (self.gripper.begin if self._config.gripper_search else self.gripper.begin_if_known)()
        self.estimate.read()
        ot_value_c = [self.chain.read_register(i, Register.OT_VALUE) for i in range(len(self.chain))]
        self.heat = ThermalMonitor(self._config.name, *trips_c(ot_value_c), [m.name for m in self.chain.motors])
        arm_inspection.clear_stale_faults(self._config.name, self.chain)

    def adopt(self, record: np.ndarray) -> None:
        """Adopt offsets, gripper stops and positions from the last state `record` published by a dead loop."""
        slots = self._hardware.slots
        self._map.offset_rad[:] = np.nan_to_num(record["offset_rad"][slots])
        motor_q, motor_dq = np.nan_to_num(record["q"][slots]), np.nan_to_num(record["dq"][slots])
        if self.gripper is not None:
            self.gripper.adopt(*record["gripper_stops_rad"].tolist())
            if self.gripper.stops is not None:
                motor_q[-1] = self.gripper.stops.motor(float(motor_q[-1]))
                motor_dq[-1] *= self.gripper.stops.span_rad
        direction = self._hardware.direction
        assumed_rad = self._map.motor(motor_q)
        self.chain.feedback.assume(assumed_rad, motor_dq * direction, record["motor_stamp_s"][slots])
        self.chain.feedback.distrust(np.flatnonzero(record["distrusted"][slots]).tolist(), assumed_rad)
        for _ in range(3):
            if all(self.chain.refresh(timeout_s=0.01)):
                break
        self.estimate.read()

    def complaints(self) -> list[str]:
        """Return warnings about adapter and cable to be logged at the end of the session."""
        chain, said = self.chain, []
        where = f"{self._config.name} ({chain.channel})"
        if chain.round_trip.slow:
            said.append(f"{where}: {chain.round_trip.summary()}; the arm was seen and commanded that much too late")
        lost = int(chain.lost.sum())
        if lost >= _LOST:
            said.append(f"{where}: {lost} answers were lost; check cable, plugs and termination")
        if chain.error_frames:
            said.append(f"{where}: CAN error frames: {chain.error_frames}; check cable, termination and bit-rate")
        return said

    def send(self, commands: np.ndarray) -> None:
        """Send commands (n, 5).

        Raises:
            BusError: the channel does not accept the frames.
            ActionError: the commands are not finite.
        """
        instead, self.instead = self.instead, {}
        self.chain.send(self._map.commands(commands), instead)
        self.sent[:] = commands

    def receive(self, until_s: float) -> None:
        """Process the replies to the last `send`; wait for late ones until `until_s`. Raises BusError: channel lost."""
        self.chain.collect(until_s)
        self.estimate.read()

    def shift_gripper(self, shift_rad: float) -> None:
        """Shift the gripper's reading by `shift_rad`, onto the motor turn of its stops."""
        self._map.shift(self._hardware.n - 1, shift_rad)
        self.estimate.read()

    def resolve(self, joints: Sequence[int]) -> None:
        """Shift the readings of `joints` onto the motor turn within the joint limits. Raises YamError: no turn fits."""
        arm = self._hardware.arm
        for index in joints:
            low, high = arm.joint_limits_rad[index]
            angle = float(self.estimate.motor_q[index])
            name, place = arm.motors[index].name, self._config.on_command_line
            self._map.shift(index, resolve_turn(self._config.name, name, angle, low, high, place))


def _trigger_range(hardware: ResolvedArm) -> TriggerRange:
    """Return the calibrated trigger range; the nominal range without a file or with `gripper_search` off.

    Raises:
        GripperError: the file is damaged, or does not belong to this handle.
    """
    config = hardware.config
    if config.calibration_path is None or not config.gripper_search:
        return TriggerRange()
    return load_range(config.name, Path(config.calibration_path), hardware.gripper.name)
