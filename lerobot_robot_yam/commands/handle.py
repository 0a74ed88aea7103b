"""Show and set up a leader's teaching handle. Energises nothing.

yam-handle show --channel can_leader_l                          firmware, report mode, trigger, buttons
yam-handle live --channel can_leader_l                          trigger and buttons live, until Enter
yam-handle report --channel can_leader_l 0                      reports only when it is asked, as sessions need it
yam-handle zero --channel can_leader_l                          the released trigger reads 0 from now on
yam-handle range --channel can_leader_l --calibration left.json   learn how far this trigger goes
"""

import argparse
import json
import math
import select
import sys
from collections.abc import Callable, Iterator, Sequence

from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, arm_config, own_bus
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command, seconds
from lerobot_robot_yam.commands.lib.dialogue import confirm_word, need_terminal, say, tell
from lerobot_robot_yam.control.gripper.trigger_range import learn, load_range, save_range
from lerobot_robot_yam.damiao.handle_encoder import EEPROM_ZERO_HIGH, EEPROM_ZERO_LOW, FIRMWARE_REQUIRED, HandleReport
from lerobot_robot_yam.damiao.settings.handle_access import HandleAccess
from lerobot_robot_yam.system.paths import user_path

HANDLE = "yam_teaching_handle"
_LIVE_S = 0.05
_LEARN_S = 8.0  # default duration of squeezing and releasing the trigger, s: as in lerobot-calibrate
_BAR = 20
_Work = Callable[[argparse.Namespace, HandleAccess], None]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-handle`; return its exit status."""
    parser = command_parser("yam-handle", __doc__)
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")

    def action(name: str, work: _Work, text: str) -> argparse.ArgumentParser:
        sub = actions.add_parser(name, help=text, description=text)
        add_arm_arguments(sub)
        sub.set_defaults(work=work, yes=True)
        return sub

    show = action("show", _show, "show firmware, report mode, trigger and buttons; reads only")
    show.add_argument("--json", action="store_true", help="print it as JSON")
    live = action("live", _live, "show trigger and buttons live; reads only")
    live.add_argument("--seconds", type=seconds, help="for how long (default: until Enter)")
    report = action("report", _report, "set how often it reports without being asked")
    report.add_argument("hz", type=int, help="0: only when asked, as sessions need it; at most 600")
    zero = action("zero", _zero, "make the released trigger read 0")
    zero.add_argument("--yes", action="store_true", default=False, help="do not ask; the trigger is released")
    learnt = action("range", _range, "learn how far this trigger goes, and keep it in a file")
    learnt.add_argument("--seconds", type=seconds, default=_LEARN_S, help="how long to squeeze and let go (default 8)")
    for sub, needed in ((learnt, True), (live, False), (show, False)):
        text = "file with the trigger's range: `calibration_path` of the leader"
        sub.add_argument("--calibration", type=user_path, required=needed, metavar="PATH", help=text)
    args = parser.parse_args(arguments)
    return run_command("yam-handle", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    config = arm_config(args, gripper=HANDLE)
    need_terminal(args.yes)
    with own_bus(config) as bus:
        args.work(args, HandleAccess(bus, config.channel))
    return 0


def _show(args: argparse.Namespace, handle: HandleAccess) -> None:
    firmware, frequency, report = handle.firmware(), handle.report_frequency(), handle.report()
    zero = int.from_bytes((handle.eeprom(EEPROM_ZERO_HIGH), handle.eeprom(EEPROM_ZERO_LOW)), "big", signed=True)
    facts = {
        "firmware": ".".join(map(str, firmware)),
        "report_frequency_hz": frequency,
        "zero_counts": zero,
        "trigger_rad": round(report.position_rad, 4),
        "trigger": round(_share(args, report), 3),
        "buttons": [int(button) for button in report.buttons],
    }
    if args.json:
        say(json.dumps({"channel": handle.channel, **facts}))
        return
    sys.stdout.write("".join(f"{name.replace('_', ' '):<20} {value}\n" for name, value in facts.items()))
    if firmware < FIRMWARE_REQUIRED:
        needed = ".".join(map(str, FIRMWARE_REQUIRED))
        tell(f"note: sessions need firmware {needed} or later; update it with the vendor's tool")
    if frequency:
        tell(f"note: it takes {frequency} frames a second from the motors: yam-handle report 0")


def _live(args: argparse.Namespace, handle: HandleAccess) -> None:
    handle.firmware()
    for report in _reports(handle, args.seconds):
        share = _share(args, report)
        bar = "#" * round(_BAR * share)
        sync, record = ("DOWN" if button else "up" for button in report.buttons)
        tell(
            f"\rtrigger {share:4.2f} [{bar:<{_BAR}}] {report.position_rad:+.3f} rad  sync {sync:4}  record {record:4}",
            "",
        )
    tell("")


def _report(args: argparse.Namespace, handle: HandleAccess) -> None:
    handle.firmware()
    handle.set_report_frequency(args.hz)
    tell("it reports " + (f"{args.hz} times a second" if args.hz else "only when it is asked") + "; read back")
    if args.hz:
        tell("note: that takes the bus from the motors; sessions set it to 0 again")


def _zero(args: argparse.Namespace, handle: HandleAccess) -> None:
    handle.firmware()
    tell(f"the trigger reads {handle.report().position_rad:+.3f} rad")
    question = "Let go of the trigger, then type zero to make this its zero:"
    confirm_word(args.yes, "zero", question, "nothing was changed")
    handle.set_zero()
    tell("the released trigger reads 0 now. Learn its range again (yam-handle range)")


def _range(args: argparse.Namespace, handle: HandleAccess) -> None:
    handle.firmware()
    tell(f"Squeeze the trigger fully and let go, some times, for {args.seconds:g} s.")
    seen = [report.trigger for report in _reports(handle, args.seconds)]
    found = learn(handle.channel, seen)
    save_range(handle.channel, args.calibration, args.gripper or HANDLE, found)
    tell(f"the trigger goes from {found.released:.3f} to {found.squeezed:.3f} of its travel; in {args.calibration}")


def _share(args: argparse.Namespace, report: HandleReport) -> float:
    """Return the trigger position, 0 released … 1 squeezed, scaled to the calibrated range if a file is given."""
    if args.calibration is None:
        return report.trigger
    return load_range(args.channel, args.calibration, args.gripper or HANDLE).share(report.trigger)


def _reports(handle: HandleAccess, seconds: float | None) -> Iterator[HandleReport]:
    """Yield requested reports until `seconds` have passed (None: no limit) or Enter is pressed."""
    end_s, terminal = math.inf if seconds is None else handle.clock.now() + seconds, sys.stdin.isatty()
    while True:
        yield handle.report()
        if not terminal:
            handle.clock.sleep(_LIVE_S)
        elif select.select([sys.stdin], [], [], _LIVE_S)[0]:
            sys.stdin.readline()
            return
        if handle.clock.now() >= end_s:
            return


if __name__ == "__main__":
    sys.exit(main())
