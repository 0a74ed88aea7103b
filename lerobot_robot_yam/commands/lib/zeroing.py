"""Procedure that makes limp motors store their angle as zero, and verifies that nothing else changed."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import can
import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD, resolve_turn
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.dialogue import table
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_inspection import verify
from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.mobile.robot_parts import Part

_UNSAID = "where its model has it at 0 (the profile says nothing more)"
_READ_BACK_RAD = 0.01  # tolerance after zeroing, rad: for zeroed motors around 0, for others around the old reading
_READ_BACK_S = 0.5  # timeout for the readings after zeroing, s: a motor may be silent while it writes its flash
_STILL_RAD, _STILL_S, _SAMPLE_S = 0.005, 0.5, 0.02


class Reading(NamedTuple):
    """Angles of all motors, (n,): an arm's joints, then the gripper's motor if there is one; or a base's motors.

    Attributes:
        motor_rad: angles that the motors report, rad.
        joint_rad: joint angles, rad, with full turns added to be within range; NaN if ambiguous, and for the gripper.
        problems: name of a joint with an ambiguous number of turns -> reason from `resolve_turn`.
    """

    motor_rad: np.ndarray
    joint_rad: np.ndarray
    problems: dict[str, str]


class Zeroing:
    """Zeroing of an arm. A limp motor executes the ZERO command, which moves its origin, but no motion command.

    Args:
        config: the arm, with the gripper that is fitted.
        bus: open bus, for exclusive use.
        joints: names of the joints to zero, such as "joint_2".

    Raises:
        ConfigError: the arm has no joint of this name, or the joint's range does not contain 0.
    """

    hazard = (
        "A zero set in a wrong pose makes the arm drive into its stops in the next session. The motors stay limp: "
        "support the arm."
    )

    def __init__(self, config: ArmConfig, bus: can.BusABC, joints: Sequence[str]):
        self._arm = arm = ResolvedArm(config)
        known = [motor.name for motor in arm.motors[: arm.joints]]
        self._begin(arm, bus, known, joints)
        for index in self.chosen:
            low, high = arm.arm.joint_limits_rad[index]
            if not low - RANGE_TOLERANCE_RAD <= 0.0 <= high + RANGE_TOLERANCE_RAD:
                raise ConfigError(f"{config.name}: the range {low:.2f} … {high:.2f} of {known[index]} does not hold 0")

    def _begin(self, part: Part, bus: can.BusABC, known: Sequence[str], joints: Sequence[str]) -> None:
        config = part.config
        self._where = f"{config.name} ({config.channel})"  # name and channel in messages
        self.names = [motor.name for motor in part.motors]
        unknown = [joint for joint in joints if joint not in known]
        if unknown or not joints:
            raise ConfigError(f"{config.name}: no joint {', '.join(unknown) or 'given'}; it has {', '.join(known)}")
        self.chosen = sorted({self.names.index(joint) for joint in joints})
        self._chain = MotorChain(bus, part.motors, channel=config.channel)
        self._clock = self._chain.clock

    def guidance(self) -> str:
        """Return instructions for placing the chosen joints at zero, with their ranges."""
        lines = ["Put these joints by hand where the profile says zero is, and support the arm so that it stays there:"]
        for index in self.chosen:
            name, (low, high) = self.names[index], self._arm.arm.joint_limits_rad[index]
            pose = self._arm.arm.zero_pose.get(name, _UNSAID)
            lines.append(f"  {name} (range {low:+.2f} … {high:+.2f} rad): {pose}")
        return "\n".join(lines)

    def angles(self, reading: Reading) -> str:
        """Return a table of angles."""
        rows = []
        for index, name in enumerate(self.names):
            joint = reading.joint_rad[index]
            shown = f"{joint:+.3f}" if math.isfinite(joint) else "unclear" if name in reading.problems else "-"
            rows.append([name, f"{reading.motor_rad[index]:+.3f}", shown, "zero" if index in self.chosen else "keep"])
        return table(["motor", "motor rad", "joint rad", ""], rows)

    def inspect(self) -> None:
        """Check that every motor replies, has the right type and is limp. Raises MotorError: a motor does not."""
        self._chain.refresh()
        self._check_limp()  # first check of the motors that reply: an energised arm is reported before other problems
        verify(self._chain)
        self._refresh()
        self._check_limp()

    def read(self) -> Reading:
        """Read the current angles. Raises MotorError: a motor does not reply."""
        self._refresh()
        motor = self._chain.position_rad.copy()
        return Reading(motor, *self._joints(motor))

    def _joints(self, motor: np.ndarray) -> tuple[np.ndarray, dict[str, str]]:
        joint = motor * self._arm.direction
        problems = {}
        for index, (low, high) in enumerate(self._arm.arm.joint_limits_rad):
            try:
                joint[index] += resolve_turn(self._arm.name, self.names[index], float(joint[index]), low, high)
            except MotorError as error:
                joint[index] = math.nan
                problems[self.names[index]] = str(error)
        joint[self._arm.joints :] = math.nan
        return joint, problems

    def require_still(self) -> None:
        """Check that the chosen joints are still for `_STILL_S`.

        Raises:
            MotorError: a joint moved by more than `_STILL_RAD`, or a motor did not reply; nothing was zeroed.
        """
        seen = []
        deadline = self._clock.now() + _STILL_S
        while self._clock.now() < deadline:
            self._refresh()
            seen.append(self._chain.position_rad[self.chosen])
            self._clock.sleep(_SAMPLE_S)
        for index, distance in zip(self.chosen, np.ptp(seen, axis=0), strict=True):
            if distance > _STILL_RAD:
                raise MotorError(
                    f"{self._where}: {self.names[index]} moved by {distance:.3f} rad within {_STILL_S} s; nothing was "
                    "zeroed. Support the arm so that it stays still, and try again"
                )

    def set_zero(self) -> tuple[Reading, Reading]:
        """Zero the chosen joints and verify; return the readings before and after. Call `require_still` right before.

        Raises:
            MotorError: a motor is energised or did not accept the zero, or the angle of another motor changed.
        """
        before = self.read()
        self._check_limp()
        self._chain.special(SpecialCommand.ZERO, motors=self.chosen)
        deadline = self._clock.now() + _READ_BACK_S
        while True:
            self._chain.feedback.restart()  # the origin has jumped: without a restart, the jump would count as motion
            try:
                after = self.read()
            except MotorError as error:
                if self._clock.now() < deadline:
                    continue
                raise MotorError(
                    f"{self._where}: zero was set, or not, of {', '.join(self.names[i] for i in self.chosen)}; then: "
                    f"{error}. Switch the power off and on and run it again for these joints before anything is "
                    "energised"
                ) from error
            failed = [i for i in self.chosen if abs(after.motor_rad[i]) > _READ_BACK_RAD]
            if not failed or self._clock.now() > deadline:
                break
        self._verify(before, after, failed)
        return before, after

    def _verify(self, before: Reading, after: Reading, failed: list[int]) -> None:
        if failed:
            read = ", ".join(f"{self.names[i]} reads {after.motor_rad[i]:.3f} rad" for i in failed)
            taken = ", ".join(self.names[i] for i in self.chosen if i not in failed) or "none"
            remedy = "Keep the arm still and run it again for these joints"
            raise MotorError(f"{self._where}: not zeroed: {read} after the command (zeroed: {taken}). {remedy}")
        changed = ", ".join(
            f"{name} from {was:.3f} to {now:.3f} rad"
            for i, (name, was, now) in enumerate(zip(self.names, before.motor_rad, after.motor_rad, strict=True))
            if i not in self.chosen and abs(now - was) > _READ_BACK_RAD
        )
        if changed:
            raise MotorError(
                f"{self._where}: other motors changed too: {changed}. If nobody moved them, two motors may share an "
                "id; check all of them before energising any"
            )
        unclear = [after.problems[self.names[i]] for i in self.chosen if self.names[i] in after.problems]
        if unclear:
            raise MotorError(f"{self._where}: zeroed, but no pose follows from it: {'; '.join(unclear)}")
        self._check_limp()

    def _refresh(self) -> None:
        """Read every motor again. Several attempts, since a single lost frame does not make a motor silent."""
        asked = self._clock.now()
        self._chain.feedback.believe(range(len(self._chain)))  # accept jumps: hands move limp joints freely
        for _ in range(5):
            self._chain.refresh()
            if (self._chain.stamp_s >= asked).all():
                return
        silent = [name for name, stamp in zip(self.names, self._chain.stamp_s, strict=True) if stamp < asked]
        raise MotorError(f"{self._where}: no answer from {', '.join(silent)}; check motor power and the CAN cable")

    def _check_limp(self) -> None:
        faults = dict(zip(self.names, self._chain.fault.tolist(), strict=True))
        enabled = [name for name, fault in faults.items() if fault == Fault.NORMAL]
        if enabled:
            raise MotorError(
                f"{self._where}: {', '.join(enabled)} energised; zeroing is for limp motors. End the "
                "program that drives it, and try again"
            )
        faulty = [(name, faults[name]) for name in (self.names[i] for i in self.chosen)]
        said = [f"{name}: {fault_text(fault)}" for name, fault in faulty if fault != Fault.DISABLED]
        if said:
            raise MotorError(
                f"{self._where}: {'; '.join(said)}. See to the fault, switch the power off and on again, and try again"
            )


class BaseZeroing(Zeroing):
    """Zeroing of a base's steering motors. The wheels' motors have no zero.

    Args:
        config: the base.
        bus: open bus, for exclusive use.
        joints: names of steering motors, such as "front_left_steer"; None: all of them.

    Raises:
        ConfigError: the base has no steering motor of this name.
    """

    hazard = "With a zero set askew, the base drives askew and its wheels fight. The motors stay limp: chock the base."

    def __init__(self, config: BaseConfig, bus: can.BusABC, joints: Sequence[str] | None):
        self._base = base = ResolvedBase(config)
        steering = [motor.name for motor in base.motors if motor.can_id in base.profile.steer_ids]
        self._steer = [index for index, motor in enumerate(base.motors) if motor.name in steering]
        self._begin(base, bus, steering, steering if joints is None else joints)

    def guidance(self) -> str:
        """Return instructions for placing the casters."""
        behind = -self._base.profile.b_x_m * 1e3
        return (
            "Turn these casters by hand so that their wheels point straight ahead, best with the alignment pins: "
            f"{', '.join(self.names[i] for i in self.chosen)}.\nEach wheel trails: its hub is {behind:.0f} mm behind "
            "the steering axis, towards the back of the base. Half a turn off would be wrong, too."
        )

    def _joints(self, motor: np.ndarray) -> tuple[np.ndarray, dict[str, str]]:
        joint = np.full(len(motor), math.nan)
        joint[self._steer] = (motor * self._base.sign)[self._steer]
        return joint, {}
