"""Find the arms, base and cameras of a rig, ask for what cannot be detected, and write one file that describes the rig.

yam-setup                       writes rig.yaml here
yam-setup lab.yaml              another file
yam-setup --dry-run             shows what it finds, and writes nothing
yam-setup --check lab.yaml      looks for mistakes in a file
yam-setup --rig NAME            a virtual rig

lerobot-record and lerobot-teleoperate take the file as --config_path; for all commands, the configs in configs/rig
refer to the file. Energises nothing. An earlier file is replaced only after the differences have been shown. Exit
status: 0 success; 1 failure, or the file has mistakes; 2 invalid arguments; 130 interrupted: run it again to continue.
"""

import argparse
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.cameras.video_devices import ROOT
from lerobot_robot_yam.commands.lib.arm_command import add_place_arguments, place_of
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import agreed, need_terminal, say, tell
from lerobot_robot_yam.commands.lib.new_rig.found_parts import find_arms, find_cameras, find_channels
from lerobot_robot_yam.commands.lib.new_rig.rig_document import difference, draw_rig, rig_text, write_rig
from lerobot_robot_yam.commands.lib.new_rig.rig_plan import Answers, RigPlan, plan_rig
from lerobot_robot_yam.doctor.check_channel import examine_channel
from lerobot_robot_yam.doctor.kit.findings import Finding, Severity, empty_report
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, BaseTarget, Target
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.system.paths import user_path

FILE = "rig.yaml"  # default name of the rig's file: the run configs in configs/rig refer to this name
_REPAIRS = {"yam-motors timeout": "motors", "yam-handle zero": "handle", "yam-handle report": "handle"}
_COMMAND = re.compile(rf"(?:{'|'.join(_REPAIRS)})[^(;]*")
_ONE_MOTOR = re.compile(r" --motor \d+")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-setup`; return its exit status."""
    parser = command_parser("yam-setup", __doc__)
    parser.add_argument("file", nargs="?", type=user_path, default=Path(FILE), help=f"the rig's file (default {FILE})")
    parser.add_argument("--check", action="store_true", help="look for mistakes in the file, and change nothing")
    parser.add_argument("--dry-run", action="store_true", help="show what is found, and change nothing")
    parser.add_argument("--yes", action="store_true", help="do not ask: take the usual answers, and make all changes")
    parser.add_argument(
        "--channel", action="append", metavar="NAME", help="an arm's channel, repeatable (default: all)"
    )
    add_place_arguments(parser)
    parser.add_argument("--root", type=user_path, help="whose sys and dev list adapters and cameras (default /)")
    args = parser.parse_args(arguments)
    return run_command("yam-setup", lambda: _check(args) if args.check else _set_up(args))


def _check(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.commands.lib.new_rig.rig_check import check_rig  # imported late: LeRobot takes seconds

    try:
        lines = check_rig(args.file)
    except ConfigError as error:
        message = str(error)
        raise ConfigError(message if str(args.file) in message else f"{args.file}: {message}") from error
    say("\n".join(lines))
    return 0


def _set_up(args: argparse.Namespace) -> int:
    sure = args.yes or args.dry_run
    need_terminal(sure)
    place = place_of(args.interface, args.rig)
    rig = place["can_options"].get("rig")
    channels = args.channel or find_channels(rig, args.root)
    arms = find_arms([ArmConfig(name=channel, channel=channel, **place) for channel in channels], tell)
    answers = Answers(args.file.with_name(args.file.name + ".answers"), sure)
    plan = plan_rig(arms, find_cameras(rig, args.root or ROOT), answers)
    say(draw_rig(plan))
    _repair(plan, args)
    text = rig_text(args.file, plan)
    changes = difference(args.file, text)
    if not changes:
        tell(f"{args.file} says so already")
    elif args.dry_run:
        say(changes)
    elif not _agreed(args, changes):
        tell("nothing was written; run it again, it goes on")
        return 1
    else:
        write_rig(args.file, text)
        tell(f"{args.file} is written")
    if not args.dry_run:
        answers.forget()
        base = f"yam-base check --config_path {args.file}, " if plan.base is not None else ""
        tell(f"Now: yam-doctor --config_path={args.file}, {base}then lerobot-calibrate (docs/setup.md)")
    return 0


def _agreed(args: argparse.Namespace, changes: str) -> bool:
    """Return whether the file may be written: an earlier file is replaced only with --yes or after confirmation."""
    if not args.file.exists() or args.yes:
        return True
    tell(changes)
    return agreed(f"Make these changes in {args.file}?")


def _repair(plan: RigPlan, args: argparse.Namespace) -> None:
    """Print yam-doctor's findings about the arms, and run the yam commands that fix these findings."""
    findings = _inspected(plan)
    commands = _repairs_of(findings)
    repaired = [finding for some in commands.values() for finding in some]
    for finding in findings:
        if finding not in repaired:
            tell(f"{finding.severity}: {finding.where}: {finding.what}\n  -> {finding.remedy}")
    for command, some in commands.items():
        more = f", and {len(some) - 1} more like it" if len(some) > 1 else ""
        tell(f"\n{some[0].severity}: {some[0].where}: {some[0].what}{more}\n  -> {command}")
        if not args.dry_run and not _run_repair(command, args.yes):
            tell("that was left as it is; yam-doctor will name it again")


def _inspected(plan: RigPlan) -> list[Finding]:
    """Return the problems and warnings about the base and the arms with motors. Reads only; energises nothing."""
    report = empty_report()
    for arm in [*plan.followers.values(), *plan.leaders.values()]:
        options = {key: value for key, value in arm.options.items() if key in ArmConfig.__dataclass_fields__}
        if "kind" not in arm.options:
            target = Target(ArmConfig(**{"name": arm.channel, "gripper": LEADER_GRIPPER, **options}))
            examine_channel(target, None, 0, report, lambda text: tell(f"{text} …"))
    if plan.base is not None:
        config = BaseConfig(**{"name": plan.base.channel, **plan.base.options})
        examine_channel(BaseTarget(config), None, 0, report, lambda text: tell(f"{text} …"))
    found = [finding for section in report.values() for finding in section.findings]
    return [finding for finding in found if finding.severity is not Severity.NOTE]


def _repairs_of(findings: list[Finding]) -> dict[str, list[Finding]]:
    """Return command -> findings that the command fixes; one command covers all motors of an arm."""
    commands: dict[str, list[Finding]] = {}
    for finding in findings:
        if (match := _COMMAND.search(finding.remedy)) is not None:
            commands.setdefault(_ONE_MOTOR.sub("", match[0]).strip(), []).append(finding)
    return commands


def _run_repair(command: str, sure: bool) -> bool:
    """Run a command, which may ask for confirmation at this terminal; return whether the command succeeded."""
    words = shlex.split(command)
    program = [sys.executable, "-m", f"lerobot_robot_yam.commands.{_REPAIRS[' '.join(words[:2])]}"]
    yes = ["--yes"] if sure and words[1] != "report" else []
    return subprocess.run([*program, *words[1:], *yes], check=False).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
