"""Set the zero of an arm's joints, or of a base's casters: guided, verified, with every motor limp.

yam-zero --channel can_follower_l                    all joints
yam-zero --channel can_follower_l --joint joint_2 joint_3
yam-zero --channel can_base --arm base               the steering motors of a mobile base

HAZARD: every later session relies on the zero that is set here. A zero set in a wrong pose makes the arm drive into its
stops in the next session, and the base drive askew. Nothing is energised.
"""

import argparse
import json
import math
import select
import sys
from collections.abc import Sequence
from typing import Any

import can

from lerobot_robot_yam.arm.config import NO_ARM, ArmConfig
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, own_bus, part_config, with_answering_gripper
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import confirm_word, need_terminal, say, tell
from lerobot_robot_yam.commands.lib.zeroing import BaseZeroing, Reading, Zeroing
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig

_WORD = "zero"
_LIVE_S = 0.2  # display period of the angles, s
_CHANGE_RAD = 0.05  # maximum expected change of a zero, rad: accuracy of careful placing by hand


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-zero`; return its exit status."""
    parser = command_parser("yam-zero", __doc__)
    add_arm_arguments(parser, base=True)
    parser.add_argument(
        "--joint",
        nargs="+",
        action="extend",
        metavar="JOINT",
        help="joints, such as joint_2 (default: all; of a base the steering)",
    )
    parser.add_argument("--yes", action="store_true", help="do not ask; the joints are at their zero already")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args(arguments)
    return run_command("yam-zero", lambda: _zero(args))


def _zero(args: argparse.Namespace) -> int:
    config = part_config(args)
    if args.arm == NO_ARM:
        raise ConfigError("a gripper has no zero to set: its stops are found by calibration (lerobot-calibrate)")
    need_terminal(args.yes)
    with own_bus(config) as bus:
        zeroing = _zeroing(args, config, bus)
        chosen = ", ".join(zeroing.names[i] for i in zeroing.chosen)
        tell(f"HAZARD: this sets the zero of {chosen} on channel {config.channel}. {zeroing.hazard}")
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


def _zeroing(args: argparse.Namespace, config: ArmConfig | BaseConfig, bus: can.BusABC) -> Zeroing:
    if isinstance(config, BaseConfig):
        return BaseZeroing(config, bus, args.joint)
    joints = args.joint or [motor.name for motor in load_arm(config.arm).motors]
    return Zeroing(with_answering_gripper(args, bus), bus, joints)  # detects the gripper: its motor is checked


def _wait_until_placed(zeroing: Zeroing) -> None:
    """Show the angles of the chosen joints live until the user presses Enter."""
    tell("Press Enter when they are in place.")
    while not select.select([sys.stdin], [], [], _LIVE_S)[0]:
        motor = zeroing.read().motor_rad
        live = "  ".join(f"{zeroing.names[i]} {motor[i]:+.3f}" for i in zeroing.chosen)
        tell(f"\rmotor rad: {live}", end=" ")
    sys.stdin.readline()
    tell(zeroing.angles(zeroing.read()))


def _as_json(zeroing: Zeroing, before: Reading, after: Reading) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(zeroing.names):
        found[name] = {"zeroed": i in zeroing.chosen}
        for when, reading in (("before", before), ("after", after)):
            for kind, value in (("motor_rad", reading.motor_rad[i]), ("joint_rad", reading.joint_rad[i])):
                found[name][f"{when}_{kind}"] = float(value) if math.isfinite(value) else None
    return found


if __name__ == "__main__":
    sys.exit(main())
