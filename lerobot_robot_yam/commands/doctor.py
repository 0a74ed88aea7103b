"""Check whether a rig is fit for use. Only reads state: moves nothing and energises nothing.

yam-doctor                                             all CAN interfaces, cameras, this computer
yam-doctor --config_path=configs/real/record.yaml      the arms and cameras of a LeRobot run config
yam-doctor --channel can_follower_l:yam:linear_4310 --channel can_leader_l:yam:yam_teaching_handle
yam-doctor --channel can_base:base                     a mobile base
yam-doctor --interface yam_sim --rig NAME --channel follower_left      a virtual rig
yam-doctor --host 192.168.1.20                         the arms of another computer, and that computer (yam-host)

Exit status: 0 healthy, 1 problems, 2 wrong usage. Warnings and notes do not change it.
"""

import argparse
import io
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.arm.config import ARMS, GRIPPERS, SOCKETCAN, VIRTUAL, ArmConfig
from lerobot_robot_yam.cameras.video_devices import video_devices
from lerobot_robot_yam.commands.lib.command_line import command_parser
from lerobot_robot_yam.commands.lib.dialogue import tell
from lerobot_robot_yam.commands.lib.host_option import add_host_arguments, run_tool
from lerobot_robot_yam.doctor.check_adapters import RULES_DIRECTORIES, check_adapters, read_rules
from lerobot_robot_yam.doctor.check_calibration import check_calibrations
from lerobot_robot_yam.doctor.check_cameras import DEV, check_cameras
from lerobot_robot_yam.doctor.check_channel import examine_channel
from lerobot_robot_yam.doctor.check_host import check_host
from lerobot_robot_yam.doctor.check_link import IP_COMMAND, TC_COMMAND, Link, check_links, parse_links, tool_output
from lerobot_robot_yam.doctor.kit.findings import Report, Section, as_json, as_text, empty_report, exit_status
from lerobot_robot_yam.doctor.kit.targets import Examined, Plan, Target, calibration_root, from_config, from_option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BASE
from lerobot_robot_yam.system.sysfs import SYSFS, read_adapters

_SAMPLES = 200


def examine(plan: Plan, samples: int = _SAMPLES, sysfs: Path = SYSFS) -> Report:
    """Check everything in the plan; if the plan has no target, check all CAN interfaces of this computer."""
    report = empty_report()
    targets: list[Examined] = list(plan.targets)
    links: dict[str, Link] | None = None
    if plan.real:
        wanted = [target.channel for target in targets if target.real]
        links = _read_links(wanted, sysfs, report["interfaces"])
        if not targets:
            wanted = list(links or ())
            targets = [Target(ArmConfig(channel=name, name=name), declared=False) for name in wanted]
        check_adapters(read_adapters(sysfs), wanted, read_rules(RULES_DIRECTORIES), report["adapters"])
    if plan.real or plan.real_cameras:
        check_cameras(video_devices(sysfs=sysfs), plan.cameras, DEV, report["cameras"])
    for target in targets:
        link = links.get(target.channel) if links is not None and target.real else None
        if link is not None or links is None or not target.real:  # otherwise the interface does not exist
            examine_channel(target, link, samples, report, lambda text: tell(f"yam-doctor: {text} …"))
    arms = [target for target in targets if isinstance(target, Target)]
    check_calibrations(arms, calibration_root(), report["gripper_calibration"])
    check_host(sysfs, report["host"])
    return report


def _read_links(wanted: Sequence[str], sysfs: Path, section: Section) -> dict[str, Link] | None:
    """Return name -> link as reported by the tools ip and tc, or None if ip fails.

    Adds the findings about the wanted links to `section`; if `wanted` is empty, about all links.
    """
    text, reason = tool_output(IP_COMMAND)
    try:
        if text is None:
            raise ValueError(reason)
        links = {link.name: link for link in parse_links(text, tool_output(TC_COMMAND)[0])}
    except ValueError as error:
        what = f"the state of the CAN interfaces is unknown: {' '.join(IP_COMMAND)} failed ({error})"
        section.warn("this computer", what, "sudo apt install iproute2")
        return None
    check_links(list(links.values()), wanted or list(links), section)
    plugged = f"plug the adapter in (`lsusb -d 1d50:606f` lists it); the system shows {', '.join(links) or 'none'}"
    if not links and not wanted:
        section.problem("this computer", "it has no CAN interface", plugged)
    for name in wanted:
        if name in links:
            continue
        if (sysfs / "class" / "net" / name).exists():
            section.note(name, "is no CAN controller (vcan?): the state of its link is unknown", "nothing to do")
            links[name] = Link(name=name, up=True)
        else:
            section.problem(name, "there is no such interface", plugged)
    return links


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-doctor`; return its exit status."""
    parser = command_parser("yam-doctor", __doc__)
    parser.add_argument(
        "--channel",
        action="append",
        default=[],
        metavar="NAME[:ARM[:GRIPPER]]",
        help=f"an arm, or NAME:{BASE}, a mobile base; repeatable. ARM: {', '.join(ARMS)} (default yam); "
        f"GRIPPER: {', '.join(GRIPPERS)} "
        "(default linear_4310; a leader's must be named)",
    )
    parser.add_argument("--interface", help=f"python-can interface (default {SOCKETCAN}, with --rig {VIRTUAL})")
    parser.add_argument("--rig", help="name of the virtual rig")
    parser.add_argument("--config_path", type=Path, metavar="FILE", help="LeRobot run config with our robots")
    parser.add_argument("--samples", type=int, default=_SAMPLES, help="questions per motor for the reply latency")
    parser.add_argument("--verbose", action="store_true", help="also tables of everything that was measured")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")
    parser.add_argument("--sysfs", type=Path, default=SYSFS, help="where sysfs is (a copy of another computer's)")
    add_host_arguments(parser)
    args = parser.parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s %(message)s")
    if args.arms_host is not None:
        return run_tool("yam-doctor", args, tool="doctor")
    try:
        plan = _plan(args)
    except ConfigError as error:
        tell(f"yam-doctor: {error}")
        return 2
    report = examine(plan, args.samples, args.sysfs)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # the terminal's encoding may lack characters such as "…"
    sys.stdout.write((as_json(report) if args.json else as_text(report, args.verbose)) + "\n")
    return exit_status(report)


def _plan(args: argparse.Namespace) -> Plan:
    if args.samples < 0:
        raise ConfigError("--samples is 0 or more")
    if args.config_path is not None:
        if args.channel:
            raise ConfigError("give --channel or --config_path, not both")
        from lerobot_robot_yam.commands.servers.rig_reader import check_options  # imported late: takes 0.3 s

        return from_config(args.config_path, args.rig, check_options)
    interface = args.interface or (VIRTUAL if args.rig else SOCKETCAN)
    if interface != SOCKETCAN and not args.channel:
        raise ConfigError(f"name the channels of interface {interface}: --channel NAME[:ARM[:GRIPPER]]")
    targets = [from_option(text, interface, args.rig) for text in args.channel]
    if len({target.channel for target in targets}) < len(targets):
        raise ConfigError("a channel is named twice")
    return Plan(tuple(targets))


if __name__ == "__main__":
    sys.exit(main())
