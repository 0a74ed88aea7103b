"""Bring a mobile base up: check how it rolls, and measure its sizes.

yam-base check --channel can_base                 limp: you push it; tells wrong zeros and swapped motors
yam-base tune --channel can_base                  ENERGISES the base: 1 m straight, one turn; you measure
yam-base tune --config_path rig.yaml              the same of the base in a rig's file, which gets the sizes

tune asks first.
"""

import argparse
import select
import sys
from collections.abc import Callable, Sequence

from lerobot_robot_yam.commands.lib.arm_command import add_place_arguments, own_bus, place_of
from lerobot_robot_yam.commands.lib.base_tune import measure_base, write_sizes
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import ask, confirm_word, need_terminal, say, tell
from lerobot_robot_yam.commands.lib.roll_check import SAMPLE_S, RolledBase, roll_check
from lerobot_robot_yam.doctor.kit.targets import BaseTarget, from_config
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.system.paths import user_path

_WORD = "drive"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-base`; return its exit status."""
    parser = command_parser("yam-base", __doc__)
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, work, text in (
        ("check", _check, "roll the limp base by hand: are zeros, ids and directions right?"),
        ("tune", _tune, "ENERGISE the base, drive a measured way, and find wheel radius and track"),
    ):
        sub = actions.add_parser(name, help=text, description=text)
        place = sub.add_mutually_exclusive_group(required=True)
        place.add_argument("--channel", help="CAN channel of the base, such as can_base")
        place.add_argument("--config_path", type=user_path, metavar="FILE", help="rig's file or run config with a base")
        add_place_arguments(sub)
        sub.set_defaults(work=work)
        if name == "tune":
            sub.add_argument("--distance", type=float, default=1.0, metavar="M", help="straight way (default 1 m)")
    args = parser.parse_args(arguments)
    return run_command("yam-base", lambda: int(args.work(args)))


def _config(args: argparse.Namespace) -> BaseConfig:
    if args.channel:
        return BaseConfig(name=args.channel, channel=args.channel, **place_of(args.interface, args.rig))
    for target in from_config(args.config_path, args.rig).targets:
        if isinstance(target, BaseTarget):
            return target.config
    raise ConfigError(f"{args.config_path} has no robot with a base")


def _check(args: argparse.Namespace) -> int:
    config = _config(args)
    need_terminal(False)
    with own_bus(config) as bus:
        tell("Nothing is energised. The base has to be free to roll, on level ground.")
        shown, problems = roll_check(RolledBase(config, bus), _person)
    say(shown)
    for problem in problems:
        tell(f"problem: {problem}")
    if not problems:
        tell("the base rolls true: zeros, ids and directions are right")
    return int(bool(problems))


def _person(text: str, sample: Callable[[], None]) -> None:
    tell(text)
    while not select.select([sys.stdin], [], [], SAMPLE_S)[0]:
        sample()
    if not sys.stdin.readline():
        raise ConfigError("the terminal gave no answer")
    sample()


def _tune(args: argparse.Namespace) -> int:
    config = _config(args)
    need_terminal(False)
    if not 0.3 <= args.distance <= 10.0:
        raise ConfigError(f"--distance is 0.3 to 10 m, not {args.distance:g}")
    tell(
        f"HAZARD: this energises the base on channel {config.channel}: it drives {args.distance:g} m straight ahead, "
        "then turns once, counter-clockwise. Keep 1 m around it clear, and the emergency stop within reach. Mark on "
        "the floor where it stands."
    )
    confirm_word(False, _WORD, f"Type {_WORD} to go on:")
    sizes = measure_base(config, args.distance, _number)
    say(f"wheel_radius_m: {sizes.wheel_radius_m}\ntrack_factor: {sizes.track_factor}")
    if args.config_path:
        write_sizes(args.config_path, sizes)
        tell(f"{args.config_path} has them")
    return 0


def _number(question: str, likely: float) -> float:
    while True:
        try:
            return float(ask(f"{question} [{likely:.3f}]") or likely)
        except ValueError:
            tell("give a number")


if __name__ == "__main__":
    sys.exit(main())
