"""Set the zero of an arm's joints: guided, verified, with every motor limp.

yam-zero --channel can_follower_l                    all joints
yam-zero --channel can_follower_l --joint joint_2 joint_3

HAZARD: what the motors are told here is what every later session believes. A zero set in a wrong pose makes the arm
drive into its stops. Nothing is energised.
"""

import argparse
import json
import math
import select
import sys
from collections.abc import Sequence
from typing import Any

import can

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import gripper_id
from lerobot_robot_yam.arm.profile import ArmProfile
from lerobot_robot_yam.arm.profile_files import NO_ARM, load_arm
from lerobot_robot_yam.commands.lib.arm_command import (
    add_arm_arguments,
    arm_config,
    ask,
    need_terminal,
    own_bus,
    run_command,
    table,
    tell,
)
from lerobot_robot_yam.commands.lib.zeroing import Reading, Zeroing
from lerobot_robot_yam.control.preflight.role import answering_gripper
from lerobot_robot_yam.errors import ConfigError

_WORD = "zero"
_LIVE_S = 0.2
_UNSAID = "where its model has it at 0 (the profile says nothing more)"
_CHANGE_RAD = 0.05  # what a careful hand may be off by


def guidance(zeroing: Zeroing) -> str:
    """Where to put the chosen joints, with their ranges."""
    arm = zeroing.hardware.arm
    lines = ["Put these joints by hand where the profile says zero is, and support the arm so that it stays there:"]
    for index in zeroing.chosen:
        name = zeroing.names[index]
        low, high = arm.joint_limits_rad[index]
        lines.append(f"  {name} (range {low:+.2f} … {high:+.2f} rad): {arm.zero_pose.get(name, _UNSAID)}")
    return "\n".join(lines)


def angles(zeroing: Zeroing, reading: Reading) -> str:
    """Table of the present angles."""
    rows = []
    for index, name in enumerate(zeroing.names):
        joint = reading.joint_rad[index]
        shown = f"{joint:+.3f}" if math.isfinite(joint) else "unclear" if name in reading.problems else "-"
        rows.append([name, f"{reading.motor_rad[index]:+.3f}", shown, "zero" if index in zeroing.chosen else "keep"])
    return table(["motor", "motor rad", "joint rad", ""], rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-zero`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-zero",
        description="Set the zero of an arm's joints; all motors stay limp. HAZARD: with a zero set in a wrong pose "
        "the arm drives into its stops in the next session.",
    )
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
    arm = load_arm(config.arm)
    joints = args.joint or [motor.name for motor in arm.motors]
    if config.arm == NO_ARM:
        raise ConfigError("a gripper has no zero to set: its stops are found by calibration (lerobot-calibrate)")
    need_terminal(args.yes)
    tell(
        f"HAZARD: this sets the zero of {', '.join(joints)} of the arm on channel {config.channel}. A zero set in a "
        "wrong pose makes the arm drive into its stops in the next session. The motors stay limp: support the arm."
    )
    with own_bus(config) as bus:
        zeroing = Zeroing(_with_gripper(args, config, bus, arm), bus, joints)
        zeroing.inspect()
        tell(angles(zeroing, zeroing.read()))
        tell(guidance(zeroing))
        if not args.yes:
            _wait_until_placed(zeroing)
        _warn_of_change(zeroing, zeroing.read())
        if not args.yes and ask(f"Type {_WORD} to make the present pose the zero of these joints:") != _WORD:
            raise ConfigError("not confirmed; nothing was zeroed")
        zeroing.require_still()
        before, after = zeroing.set_zero()
    _report(args, zeroing, before, after)
    return 0


def _with_gripper(args: argparse.Namespace, config: ArmConfig, bus: can.BusABC, arm: ArmProfile) -> ArmConfig:
    """The configuration with the gripper that answers, unless one was given: its motor must not change."""
    if args.gripper is not None:
        return config
    return arm_config(args, gripper=answering_gripper(bus, config.channel, gripper_id(arm)))


def _wait_until_placed(zeroing: Zeroing) -> None:
    """Show the angles of the chosen joints live until Enter."""
    tell("Press Enter when they are in place.")
    while not select.select([sys.stdin], [], [], _LIVE_S)[0]:
        motor = zeroing.read().motor_rad
        live = "  ".join(f"{zeroing.names[i]} {motor[i]:+.3f}" for i in zeroing.chosen)
        tell(f"\rmotor rad: {live}", end=" ")
    sys.stdin.readline()
    tell(angles(zeroing, zeroing.read()))


def _warn_of_change(zeroing: Zeroing, present: Reading) -> None:
    """Warn of joints whose angle will change: wanted after a repair, otherwise a mistake."""
    far = [
        f"{zeroing.names[i]} by {-present.joint_rad[i]:+.2f}"
        for i in zeroing.chosen
        if abs(present.joint_rad[i]) > _CHANGE_RAD
    ]
    if far:
        tell(f"WARNING: this changes where these joints are taken to be, in rad: {', '.join(far)}")


def _report(args: argparse.Namespace, zeroing: Zeroing, before: Reading, after: Reading) -> None:
    if args.json:
        motors: dict[str, dict[str, Any]] = {
            name: {"zeroed": i in zeroing.chosen} for i, name in enumerate(zeroing.names)
        }
        for when, reading in (("before", before), ("after", after)):
            for kind in ("motor_rad", "joint_rad"):
                for name, value in zip(zeroing.names, getattr(reading, kind).tolist(), strict=True):
                    motors[name][f"{when}_{kind}"] = value if math.isfinite(value) else None
        sys.stdout.write(json.dumps({"channel": zeroing.channel, "motors": motors}) + "\n")
    else:
        sys.stdout.write(
            f"before:\n{angles(zeroing, before)}\nafter:\n{angles(zeroing, after)}\n"
            "zeroed and read back; the other motors did not change\n"
        )
    for problem in after.problems.values():
        tell(f"note: {problem}")


if __name__ == "__main__":
    sys.exit(main())
