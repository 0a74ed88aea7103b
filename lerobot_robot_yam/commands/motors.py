"""Show and set up the motors of an arm or a base: ids, registers, time-out, dumps. Only `console` energises anything.

yam-motors scan --channel can_follower_l                             who answers: type, firmware, limits, faults, heat
yam-motors read --channel can_follower_l --motor joint_3 TIMEOUT     registers by name; all of them without a name
yam-motors write --channel can_follower_l --motor joint_3 OT_VALUE=100 --store
yam-motors store --channel can_follower_l --motor joint_3            RAM to flash, and nothing else changes
yam-motors set-id --channel can_follower_l 1 7                       the motor with id 1 gets id 7
yam-motors timeout --channel can_follower_l 0.4                      seconds without a command until it lets go
yam-motors dump --channel can_follower_l left.yaml                   all registers of the arm, into a file
yam-motors diff --channel can_follower_l left.yaml                   exit status 1 when something differs
yam-motors restore --channel can_follower_l left.yaml                writes back what differs, and stores it
yam-motors console --channel can_follower_l --motor joint_6          ENERGISES this motor: it follows the arrow keys
yam-motors monitor --channel can_follower_l                          beside a session: latency and lost answers
yam-motors scan --channel can_base --arm base                        the motors of a mobile base
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence

from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, own_bus, part_config
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command, seconds
from lerobot_robot_yam.commands.lib.dialogue import need_terminal, say, table, tell
from lerobot_robot_yam.commands.lib.motor.motor_bench import MotorBench, nothing_answers
from lerobot_robot_yam.commands.lib.motor.motor_changes import (
    restore_arm,
    set_id,
    store_motors,
    timeout,
    write_registers,
)
from lerobot_robot_yam.commands.lib.motor.motor_console import console
from lerobot_robot_yam.commands.lib.motor.motor_dump import load_dump, save_dump, shown
from lerobot_robot_yam.commands.lib.motor.motor_monitor import monitor_session
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.damiao.settings.motor_memory import changes
from lerobot_robot_yam.damiao.settings.register_ranges import register_named
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.system.paths import user_path

_ALL_IDS = range(1, 128)
_Work = Callable[[argparse.Namespace, MotorBench], int]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-motors`; return its exit status."""
    parser = command_parser("yam-motors", __doc__)
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")

    def action(name: str, work: _Work, text: str, motors: bool = True, asks: bool = False) -> argparse.ArgumentParser:
        sub = actions.add_parser(name, help=text, description=text)
        add_arm_arguments(sub, base=True)
        sub.set_defaults(work=work, yes=True)
        if motors:
            text = "names or CAN ids, with commas (default: all that answer)"
            sub.add_argument("--motor", type=lambda names: names.split(","), metavar="MOTORS", help=text)
        if asks:
            sub.add_argument("--yes", action="store_true", default=False, help="do not ask")
        return sub

    scan = action("scan", _scan, "show every motor that answers; reads only", motors=False)
    scan.add_argument(
        "--all-ids", action="store_true", help="look for ids up to 127, not only for those of arms, 1 to 15"
    )
    scan.add_argument("--json", action="store_true", help="print it as JSON")
    read = action("read", _read, "show registers; reads only")
    read.add_argument("register", nargs="*", metavar="REGISTER", help="names or numbers (default: all)")
    read.add_argument("--json", action="store_true", help="print them as JSON")
    write = action("write", _write, "set registers of limp motors in RAM, and with --store in flash", asks=True)
    write.add_argument("setting", nargs="+", metavar="REGISTER=VALUE", help="such as OT_VALUE=100")
    write.add_argument("--store", action="store_true", help="store them, so that they survive a power cycle")
    action("store", store_motors, "store what limp motors hold in RAM, and see to it that nothing changes", asks=True)
    ids = action("set-id", set_id, "give a limp motor another CAN id, and store it", motors=False, asks=True)
    ids.add_argument("old", type=int, help="its present id")
    ids.add_argument("new", type=int, help="its id from now on")
    ids.add_argument("--answers", type=int, metavar="ID", help="what it answers as (MST_ID; default: its new id + 16)")
    let_go = action("timeout", timeout, "show or set the time without a command after which motors let go", asks=True)
    let_go.add_argument("seconds", nargs="?", type=float, help="0.4 is what sessions ask for; 0: NEVER lets go")
    dump = action("dump", _dump, "write all registers of an arm into a file; reads only")
    diff = action("diff", _diff, "compare an arm with a file; exit status 1 when something differs", motors=False)
    restore = action("restore", restore_arm, "write back and store what differs from a file", motors=False, asks=True)
    keys = action("console", console, "ENERGISE one motor, and turn it by the arrow keys")
    keys.add_argument("--range", type=float, default=0.5, help="how far from where it is, rad (default 0.5)")
    keys.set_defaults(yes=False)
    beside = actions.add_parser("monitor", help="beside a session: latency and lost answers; listens only")
    add_arm_arguments(beside, base=True)
    beside.add_argument("--seconds", type=seconds, default=10.0, help="how long to listen (default 10)")
    beside.add_argument("--json", action="store_true", help="print it as JSON")
    for sub in (dump, diff, restore):
        sub.add_argument("file", type=user_path, help="YAML file")
    args = parser.parse_args(arguments)
    return run_command("yam-motors", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    if args.action == "monitor":
        return monitor_session(args)
    config = part_config(args)
    if args.action != "timeout" or args.seconds is not None:
        need_terminal(args.yes)
    with own_bus(config) as bus:
        return int(args.work(args, MotorBench(config, bus)))


def _scan(args: argparse.Namespace, bench: MotorBench) -> int:
    found = bench.scan(_ALL_IDS if args.all_ids else MOTOR_IDS)
    if args.json:
        rows = {str(can_id): bench.row(can_id, motor) for can_id, motor in found.items()}
        say(json.dumps({"channel": bench.channel, "motors": rows, "notes": bench.notes(found)}))
    elif found:
        say(bench.show(found))
    if not found:
        raise MotorError(nothing_answers(bench.channel))
    if not args.json:
        for note in bench.notes(found):
            tell(f"note: {note}")
    return 0


def _read(args: argparse.Namespace, bench: MotorBench) -> int:
    wanted = [register_named(name) for name in args.register]
    held = {can_id: bench.contents(can_id) for can_id in bench.ids(args.motor)}
    if args.json:
        rows = {
            str(can_id): {r.name: shown(r, value) for r, value in contents.items() if not wanted or r in wanted}
            for can_id, contents in held.items()
        }
        say(json.dumps({"channel": bench.channel, "motors": rows}))
        return 0
    names = wanted or list(dict.fromkeys(register for contents in held.values() for register in contents))
    lines = [[r.name, *(str(shown(r, c.get(r))) for c in held.values()), r.unit] for r in names]
    say(table(["register", *map(bench.name, held), "unit"], lines))
    return 0


def _write(args: argparse.Namespace, bench: MotorBench) -> int:
    settings = {}
    for text in args.setting:
        name, _, value = text.partition("=")
        try:
            settings[register_named(name)] = float(value)
        except ValueError:
            raise ConfigError(f"{text!r} is no setting: write REGISTER=VALUE, such as OT_VALUE=100") from None
    return write_registers(args, bench, settings)


def _dump(args: argparse.Namespace, bench: MotorBench) -> int:
    held = {can_id: bench.contents(can_id) for can_id in bench.ids(args.motor)}
    save_dump(args.file, bench.channel, held)
    tell(f"{len(held)} motors are in {args.file}")
    return 0


def _diff(args: argparse.Namespace, bench: MotorBench) -> int:
    rows = [
        [bench.name(can_id), register.name, *(str(shown(register, value)) for value in values)]
        for can_id, stored in load_dump(args.file).items()
        for register, values in changes(stored, bench.contents(can_id)).items()
    ]
    if rows:
        say(table(["motor", "register", "file", "motor has"], rows))
    else:
        tell(f"the motors hold what {args.file} says")
    return int(bool(rows))


if __name__ == "__main__":
    sys.exit(main())
