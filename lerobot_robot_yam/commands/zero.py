"""Set the zero of an arm's joints: guided, verified, with every motor limp.

yam-zero --channel can_follower_l                    all joints
yam-zero --channel can_follower_l --joint joint_2 joint_3

HAZARD: every later session relies on the zero that is set here. A zero set in a wrong pose makes the arm drive into its
stops in the next session. Nothing is energised.
"""

import argparse
import json
import math
import select
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import can
import numpy as np

from lerobot_robot_yam.arm.config import NO_ARM, ArmConfig
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD, resolve_turn
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, arm_config, own_bus, with_answering_gripper
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import confirm_word, need_terminal, say, table, tell
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_inspection import verify
from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.errors import ConfigError, MotorError

_WORD = "zero"
_LIVE_S = 0.2  # display period of the angles, s
_UNSAID = "where its model has it at 0 (the profile says nothing more)"
_CHANGE_RAD = 0.05  # maximum expected change of a zero, rad: accuracy of careful placing by hand
_READ_BACK_RAD = 0.01  # tolerance after zeroing, rad: for zeroed motors around 0, for others around the old reading
_READ_BACK_S = 0.5  # timeout for the readings after zeroing, s: a motor may be silent while it writes its flash
_STILL_RAD, _STILL_S, _SAMPLE_S = 0.005, 0.5, 0.02


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-zero`; return its exit status."""
    parser = command_parser("yam-zero", __doc__)
    add_arm_arguments(parser)
    parser.add_argument(
        "--joint", nargs="+", action="extend", metavar="JOINT", help="joints to zero, such as joint_2 (default: all)"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask; the joints are at their zero already")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args(arguments)
    return run_command("yam-zero", lambda: _zero(args))


def _zero(args: argparse.Namespace) -> int:
    config = arm_config(args)
    joints = args.joint or [motor.name for motor in load_arm(config.arm).motors]
    if config.arm == NO_ARM:
        raise ConfigError("a gripper has no zero to set: its stops are found by calibration (lerobot-calibrate)")
    need_terminal(args.yes)
    tell(
        f"HAZARD: this sets the zero of {', '.join(joints)} of the arm on channel {config.channel}. A zero set in a "
        "wrong pose makes the arm drive into its stops in the next session. The motors stay limp: support the arm."
    )
    with own_bus(config) as bus:
        zeroing = Zeroing(with_answering_gripper(args, bus), bus, joints)  # detects the gripper: its motor is checked
        zeroing.inspect()
        tell(zeroing.angles(zeroing.read()))
        tell(zeroing.guidance())
        if not args.yes:
            _wait_until_placed(zeroing)
        present = zeroing.read().joint_rad
        far = [f"{zeroing.names[i]} by {-present[i]:+.2f}" for i in zeroing.chosen if abs(present[i]) > _CHANGE_RAD]
        if far:  # a large change is intended after a repair, and a mistake otherwise
            tell(f"WARNING: this changes where these joints are taken to be, in rad: {', '.join(far)}")
        question = f"Type {_WORD} to make the present pose the zero of these joints:"
        confirm_word(args.yes, _WORD, question, "nothing was zeroed")
        zeroing.require_still()
        before, after = zeroing.set_zero()
    if args.json:
        say(json.dumps({"channel": config.channel, "motors": _as_json(zeroing, before, after)}))
    else:
        sys.stdout.write(
            f"before:\n{zeroing.angles(before)}\nafter:\n{zeroing.angles(after)}\n"
            "zeroed and read back; the other motors did not change\n"
        )
    for problem in after.problems.values():
        tell(f"note: {problem}")
    return 0


def _wait_until_placed(zeroing: "Zeroing") -> None:
    """Show the angles of the chosen joints live until the user presses Enter."""
    tell("Press Enter when they are in place.")
    while not select.select([sys.stdin], [], [], _LIVE_S)[0]:
        motor = zeroing.read().motor_rad
        live = "  ".join(f"{zeroing.names[i]} {motor[i]:+.3f}" for i in zeroing.chosen)
        tell(f"\rmotor rad: {live}", end=" ")
    sys.stdin.readline()
    tell(zeroing.angles(zeroing.read()))


def _as_json(zeroing: "Zeroing", before: "Reading", after: "Reading") -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(zeroing.names):
        found[name] = {"zeroed": i in zeroing.chosen}
        for when, reading in (("before", before), ("after", after)):
            for kind, value in (("motor_rad", reading.motor_rad[i]), ("joint_rad", reading.joint_rad[i])):
                found[name][f"{when}_{kind}"] = float(value) if math.isfinite(value) else None
    return found


class Reading(NamedTuple):
    """Angles of all motors of an arm, (n,): the joints, then the gripper's motor if there is one.

    Attributes:
        motor_rad: angles that the motors report, rad.
        joint_rad: joint angles, rad, with full turns added to be within range; NaN if ambiguous, and for the gripper.
        problems: name of a joint with an ambiguous number of turns -> reason from `resolve_turn`.
    """

    motor_rad: np.ndarray
    joint_rad: np.ndarray
    problems: dict[str, str]


class Zeroing:
    """Procedure that makes limp motors store their angle as zero, and verifies that nothing else changed.

    A limp motor executes the ZERO command, which moves the motor's origin, but no motion command.

    Args:
        config: the arm, with the gripper that is fitted.
        bus: open bus, for exclusive use.
        joints: names of the joints to zero, such as "joint_2".

    Raises:
        ConfigError: the arm has no joint of this name, or the joint's range does not contain 0.
    """

    def __init__(self, config: ArmConfig, bus: can.BusABC, joints: Sequence[str]):
        self._where = f"{config.name} ({config.channel})"  # name and channel in messages
        self._arm = arm = ResolvedArm(config)
        self.names = [motor.name for motor in arm.motors]
        known = self.names[: arm.joints]
        unknown = [joint for joint in joints if joint not in known]
        if unknown or not joints:
            raise ConfigError(
                f"{config.name}: no joint {', '.join(unknown) or 'given'}; arm {config.arm!r} has {', '.join(known)}"
            )
        self.chosen = sorted({known.index(joint) for joint in joints})
        for index in self.chosen:
            low, high = arm.arm.joint_limits_rad[index]
            if not low - RANGE_TOLERANCE_RAD <= 0.0 <= high + RANGE_TOLERANCE_RAD:
                raise ConfigError(f"{config.name}: the range {low:.2f} … {high:.2f} of {known[index]} does not hold 0")
        self._chain = MotorChain(bus, arm.motors, channel=config.channel)
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
        joint = motor * self._arm.direction
        problems = {}
        for index, (low, high) in enumerate(self._arm.arm.joint_limits_rad):
            try:
                joint[index] += resolve_turn(self._arm.name, self.names[index], float(joint[index]), low, high)
            except MotorError as error:
                joint[index] = math.nan
                problems[self.names[index]] = str(error)
        joint[self._arm.joints :] = math.nan
        return Reading(motor, joint, problems)

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
                    f"{error}. Switch the arm's power off and on and run it again for these joints before anything is "
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
                "id; check the whole arm before energising it"
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
                "program that drives the arm, which lands it, or land it with one, and try again"
            )
        faulty = [(name, faults[name]) for name in (self.names[i] for i in self.chosen)]
        said = [f"{name}: {fault_text(fault)}" for name, fault in faulty if fault != Fault.DISABLED]
        if said:
            raise MotorError(
                f"{self._where}: {'; '.join(said)}. See to the fault, switch the arm's power off and "
                "on again, and try again"
            )


if __name__ == "__main__":
    sys.exit(main())
