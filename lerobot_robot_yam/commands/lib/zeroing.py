"""Make limp motors take their present angle as zero, and prove that this, and nothing else, happened.

Nothing is energised: a ZERO command moves the origin of a motor that obeys no other command while it is limp.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import can
import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD, resolve_turn
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_inspection import verify
from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.errors import ConfigError, MotorError

READ_BACK_RAD = 0.01  # a zeroed motor reads within this of 0, another one within this of before
STILL_RAD = 0.005
STILL_S = 0.5
_SAMPLE_S = 0.02
_READ_BACK_S = 0.5  # a motor that writes its flash may be silent for a moment


@dataclass(frozen=True)
class Reading:
    """Angles of all motors of an arm, (n,): the joints, then the gripper's motor if there is one.

    motor_rad: as the motors say. joint_rad: joint angles, on the turn of their range; NaN where no turn is clear, and
    for the gripper. problems: what `resolve_turn` says of those, by joint name.
    """

    motor_rad: np.ndarray
    joint_rad: np.ndarray
    problems: dict[str, str]


class Zeroing:
    """Zeroes joints of one arm.

    Args:
        config: the arm; its gripper must be the one that is fitted.
        bus: open bus; nobody else drives it.
        joints: names of the joints to zero, such as "joint_2".

    Raises:
        ConfigError: no such joint, or one whose range does not hold 0.
    """

    def __init__(self, config: ArmConfig, bus: can.BusABC, joints: Sequence[str]):
        self.name, self.channel = config.name, config.channel
        self._where = f"{config.name} ({config.channel})"  # for messages
        self.hardware = hw = ResolvedArm(config)
        names = [motor.name for motor in hw.arm.motors]
        unknown = [joint for joint in joints if joint not in names]
        if unknown or not joints:
            raise ConfigError(
                f"{self.name}: no joint {', '.join(unknown) or 'given'}; arm {config.arm!r} has {', '.join(names)}"
            )
        self.chosen = sorted({names.index(joint) for joint in joints})
        for index in self.chosen:
            low, high = hw.arm.joint_limits_rad[index]
            if not low - RANGE_TOLERANCE_RAD <= 0.0 <= high + RANGE_TOLERANCE_RAD:
                raise ConfigError(f"{self.name}: the range {low:.2f} … {high:.2f} of {names[index]} does not hold 0")
        self.chain = MotorChain(bus, hw.motors, channel=config.channel)
        self.names = [motor.name for motor in hw.motors]

    def inspect(self) -> None:
        """Refuse unless every motor is there, the right one, and limp.

        Raises:
            MotorError: names the motor.
        """
        self.chain.refresh()
        self._check_limp()  # of those that answer: an energised arm is the first thing to say
        verify(self.chain)
        self._refresh()
        self._check_limp()

    def read(self) -> Reading:
        """Present angles.

        Raises:
            MotorError: a motor does not answer.
        """
        self._refresh()
        motor = self.chain.position_rad.copy()
        joint = motor * self.hardware.direction
        problems = {}
        for index, (low, high) in enumerate(self.hardware.arm.joint_limits_rad):
            try:
                joint[index] += resolve_turn(self.name, self.names[index], float(joint[index]), low, high)
            except MotorError as error:
                joint[index] = math.nan
                problems[self.names[index]] = str(error)
        joint[self.hardware.joints :] = math.nan
        return Reading(motor, joint, problems)

    def require_still(self) -> None:
        """Watch the chosen joints for `STILL_S`.

        Raises:
            MotorError: one moved by more than `STILL_RAD`, or a motor was silent; nothing was zeroed.
        """
        seen = []
        deadline = time.monotonic() + STILL_S
        while time.monotonic() < deadline:
            self._refresh()
            seen.append(self.chain.position_rad[self.chosen])
            time.sleep(_SAMPLE_S)
        moved = np.ptp(seen, axis=0)
        for index, distance in zip(self.chosen, moved, strict=True):
            if distance > STILL_RAD:
                raise MotorError(
                    f"{self._where}: {self.names[index]} moved by {distance:.3f} rad within "
                    f"{STILL_S} s; nothing was zeroed. Support the arm so that it stays still, and try again"
                )

    def set_zero(self) -> tuple[Reading, Reading]:
        """Zero the chosen joints and verify. Call `require_still` right before.

        Returns:
            Readings before and after.

        Raises:
            MotorError: a motor is energised, did not take the zero, or another motor's angle changed with it.
        """
        before = self.read()
        self._check_limp()
        self.chain.special(SpecialCommand.ZERO, motors=self.chosen)
        deadline = time.monotonic() + _READ_BACK_S
        while True:
            self.chain.feedback.restart()  # the origin has moved: not a motion that could be followed over turns
            try:
                after = self.read()
            except MotorError as error:
                if time.monotonic() < deadline:
                    continue
                raise MotorError(
                    f"{self._where}: zero was set, or not, of "
                    f"{', '.join(self.names[i] for i in self.chosen)}; then: {error}. Switch the arm's power off and "
                    "on and run it again for these joints before anything is energised"
                ) from error
            failed = [i for i in self.chosen if abs(after.motor_rad[i]) > READ_BACK_RAD]
            if not failed or time.monotonic() > deadline:
                break
        self._verify(before, after, failed)
        return before, after

    def _verify(self, before: Reading, after: Reading, failed: list[int]) -> None:
        if failed:
            read = ", ".join(f"{self.names[i]} reads {after.motor_rad[i]:.3f} rad" for i in failed)
            taken = ", ".join(self.names[i] for i in self.chosen if i not in failed) or "none"
            remedy = "Keep the arm still and run it again for these joints"
            raise MotorError(f"{self._where}: not zeroed: {read} after the command (zeroed: {taken}). {remedy}")
        others = np.setdiff1d(np.arange(self.hardware.n), self.chosen)
        moved = [i for i in others if abs(after.motor_rad[i] - before.motor_rad[i]) > READ_BACK_RAD]
        if moved:
            changed = ", ".join(
                f"{self.names[i]} from {before.motor_rad[i]:.3f} to {after.motor_rad[i]:.3f} rad" for i in moved
            )
            raise MotorError(
                f"{self._where}: other motors changed too: {changed}. If nobody moved them, two "
                "motors may share an id; check the whole arm before energising it"
            )
        unclear = [after.problems[self.names[i]] for i in self.chosen if self.names[i] in after.problems]
        if unclear:
            raise MotorError(f"{self._where}: zeroed, but no pose follows from it: {'; '.join(unclear)}")
        self._check_limp()

    def _refresh(self) -> None:
        """A fresh answer of every motor; one lost frame is not a silent motor."""
        asked = time.monotonic()
        self.chain.feedback.believe(range(len(self.chain)))  # hands move limp joints as far as they like
        for _ in range(5):
            self.chain.refresh()
            if (self.chain.stamp_s >= asked).all():
                return
        silent = [name for name, stamp in zip(self.names, self.chain.stamp_s, strict=True) if stamp < asked]
        raise MotorError(f"{self._where}: no answer from {', '.join(silent)}; check motor power and the CAN cable")

    def _check_limp(self) -> None:
        faults = dict(zip(self.names, self.chain.fault.tolist(), strict=True))
        enabled = [name for name, fault in faults.items() if fault == Fault.NORMAL]
        if enabled:
            raise MotorError(
                f"{self._where}: {', '.join(enabled)} energised; zeroing is for limp motors. End the "
                "program that drives the arm, which lands it, or land it with one, and try again"
            )
        chosen = [(self.names[i], faults[self.names[i]]) for i in self.chosen]
        faulty = [f"{name}: {fault_text(fault)}" for name, fault in chosen if fault != Fault.DISABLED]
        if faulty:
            raise MotorError(
                f"{self._where}: {'; '.join(faulty)}. See to the fault, switch the arm's power off and "
                "on again, and try again"
            )
