"""Identify the arm on a channel: read its fingerprint, bind it to a name, check its binding, or see it move.

yam-identify --channel can_follower_l                               shows what answers; read-only
yam-identify --channel can_follower_l --name left --bind left.json  remembers it as "left"
yam-identify --channel can_follower_l --check left.json             is it still that arm? exit status 1 when not
yam-identify --channel can_follower_l --wiggle                      ENERGISES the arm: its gripper closes and opens,
                                                                    its last joint turns a little
yam-identify --channel can_follower_l --host 192.168.1.20           an arm of another computer; read-only

Only --wiggle energises anything, and asks first (--yes for scripts).
"""

import argparse
import json
import sys
from collections.abc import Sequence

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import arm_ids, gripper_id, seeks_stops
from lerobot_robot_yam.arm.profile import ArmProfile
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, arm_config, own_bus
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import ask, confirm_word, need_terminal, say, table, tell
from lerobot_robot_yam.commands.lib.host_option import add_host_arguments, run_tool
from lerobot_robot_yam.commands.lib.motor.motor_bench import nothing_answers
from lerobot_robot_yam.control.preflight.binding import bind, check_identity
from lerobot_robot_yam.control.preflight.fingerprint import Fingerprint, read_fingerprint
from lerobot_robot_yam.control.preflight.role import likely_gripper
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.system.paths import user_path

WIGGLE_RAD = 0.08
SPEED_RAD_S = 0.15
_QUESTION = "Which arm moved? Its name, or just Enter to see it again:"


def describe(channel: str, found: Fingerprint, role: str) -> str:
    """Return the fingerprint as text: role, table of motors, handle and adapter."""

    def shown(value: object) -> str:
        return "?" if value is None else str(value)

    rows = [
        [str(i), m.kind, shown(m.gear_ratio), shown(m.serial), shown(m.software), shown(m.sub), shown(m.hardware)]
        for i, m in sorted(found.motors.items())
    ]
    handle = "none" if found.handle_firmware is None else "firmware " + ".".join(map(str, found.handle_firmware))
    lines = [
        f"channel {channel}: {role}",
        table(["motor id", "type", "gear", "serial", "firmware", "sub", "hardware"], rows),
        f"teaching handle: {handle}",
        f"adapter: {found.adapter or 'none known to the kernel'}",
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-identify`; return its exit status."""
    parser = command_parser("yam-identify", "Which arm is on this CAN channel? Reads only, except with --wiggle.")
    add_arm_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the fingerprint as JSON")
    parser.add_argument("--bind", type=user_path, metavar="PATH", help="remember this arm in the file PATH")
    parser.add_argument("--force", action="store_true", help="with --bind: replace the binding of another arm")
    parser.add_argument("--check", type=user_path, metavar="PATH", help="compare with the arm bound in the file PATH")
    parser.add_argument(
        "--wiggle",
        action="store_true",
        help="ENERGISE the arm, close and open its gripper (not with --calibration), turn its last joint by 0.08 rad",
    )
    parser.add_argument(
        "--calibration", metavar="PATH", help="with --wiggle: the gripper's stored stops; it does not move then"
    )
    parser.add_argument("--yes", action="store_true", help="with --wiggle: do not ask")
    add_host_arguments(parser)
    args = parser.parse_args(arguments)
    if args.arms_host is not None:
        if args.bind or args.check or args.wiggle:
            parser.error("with --host an arm is only looked at: bind, check and wiggle it at its own computer")
        return run_tool("yam-identify", args, tool="identify", channel=args.channel)
    if args.bind and args.check:
        parser.error("--bind and --check exclude each other")
    return run_command("yam-identify", lambda: _identify(args))


def _identify(args: argparse.Namespace) -> int:
    config = arm_config(args)
    if args.wiggle:
        need_terminal(args.yes)
    arm = load_arm(config.arm)
    with own_bus(config) as bus:
        found = read_fingerprint(bus, config.channel, config.interface, arm_ids(arm))
    role = found.role(gripper_id(arm))
    facts = {"channel": config.channel, "role": role, **found.to_dict()}
    say(json.dumps(facts) if args.json else describe(config.channel, found, role))
    if not found.motors:
        raise MotorError(nothing_answers(config.channel))
    name = config.name
    if args.wiggle:
        name = _watch_it_move(args, config, found, arm)
    if args.bind:
        for note in bind(args.bind, name, config.channel, found, arm, args.force):
            tell(f"note: {note}")
        tell(f"bound as {name!r} in {args.bind}")
    elif args.check:
        warned = check_identity(args.check, found, config.channel, config.name, config.on_command_line)
        tell("this is the bound arm" + (", see the warnings" if warned else ""))
    return 0


def _watch_it_move(args: argparse.Namespace, config: ArmConfig, found: Fingerprint, arm: ArmProfile) -> str:
    """Wiggle the arm; return the name that the user gives to the arm that moved (with --yes: the config's name)."""
    if not arm.joint_count:
        raise ConfigError(f"{config.name}: arm {config.arm!r} has no joint to turn")
    gripper = args.gripper
    if gripper is None:
        can_id = gripper_id(arm)
        gear = found.motors[can_id].gear_ratio if can_id in found.motors else None
        gripper = likely_gripper(found.handle_firmware is not None, gear)
        tell(f"taking the gripper to be {gripper} (else give --gripper)")
    config = arm_config(args, gripper=gripper, calibration_path=args.calibration)
    tell(hazard(config))
    confirm_word(args.yes, "wiggle", "Clear the space around every arm, then type wiggle to go on:")
    answer = _wiggle(config, None if args.yes else _QUESTION)
    if args.yes:
        return config.name
    if args.name is not None and answer != args.name:
        raise ConfigError(
            f"{answer!r} moved, not {args.name!r}: channel {config.channel} carries {answer!r}; nothing was bound"
        )
    tell(f"channel {config.channel} carries {answer!r}")
    return answer


def hazard(config: ArmConfig) -> str:
    """Return the hazard warning that the user has to confirm."""
    text = (
        f"HAZARD: this energises the arm on channel {config.channel}, which then holds its pose, turns its last joint "
        f"by ±{WIGGLE_RAD} rad at up to {SPEED_RAD_S} rad/s, lands and goes limp. Keep hands off all arms and the "
        "emergency stop within reach."
    )
    path = config.calibration_path
    if seeks_stops(config):
        known = "give --calibration to avoid that" if path is None else f"there is no {path} yet"
        text += f" Its gripper closes and opens fully to find its stops ({known})."
    return text


def _wiggle(config: ArmConfig, question: str | None) -> str:
    """Energise the arm, hold, wiggle until the user answers `question`, and land; return the answer.

    If `question` is None, the arm wiggles once, and the answer is empty.

    Raises:
        YamError: the arm could not be started or moved; it has landed, or was never energised.
    """
    with YamArm(config, start="hold") as arm:
        home = arm.observe().setpoint_q
        while True:
            for offset in (WIGGLE_RAD, -WIGGLE_RAD, 0.0):
                arm.move_to([*home[:-1], home[-1] + offset], speed_rad_s=SPEED_RAD_S)
            answer = ask(question) if question else ""
            if answer or not question:
                return answer


if __name__ == "__main__":
    sys.exit(main())
