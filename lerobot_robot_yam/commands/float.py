"""Let one or two arms float, carried against gravity; record what your hand does with them, and replay it.

yam-float --channel can_follower_l                                   one arm, by keys
yam-float --channel can_follower_l can_follower_r                    two arms, recorded and replayed together
yam-float --channel can_follower_l --load wave.npy --output new.npy  what l and s read and write

HAZARD: this ENERGISES the arms. Files are of the form of the vendor's example. However it ends, the arms land.
"""

import argparse
import sys
from collections.abc import Sequence

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import seeks_stops
from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, each_arm, with_likely_gripper
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import confirm_word, tell, tell_landed
from lerobot_robot_yam.commands.lib.float_console import FloatConsole
from lerobot_robot_yam.commands.lib.key_terminal import key_terminal
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.trajectory_file import load_trajectory
from lerobot_robot_yam.system.paths import user_path

_WORD = "float"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-float`; returns the exit status."""
    parser = command_parser("yam-float", __doc__)
    add_arm_arguments(parser, several=True)
    parser.add_argument(
        "--calibration", nargs="+", metavar="PATH", help="the gripper's stored stops; without them it seeks its stops"
    )
    parser.add_argument("--output", type=user_path, default="trajectory.npy", help="file to save to (trajectory.npy)")
    parser.add_argument("--load", type=user_path, metavar="FILE", help="trajectory to begin with")
    parser.add_argument("--yes", action="store_true", help="do not ask before the arms are energised")
    args = parser.parse_args(arguments)
    return run_command("yam-float", lambda: _float(args))


def _float(args: argparse.Namespace) -> int:
    """Energise the arms, do as the keys say, and land them however that ends; returns the exit status."""
    if not sys.stdin.isatty():
        raise ConfigError("it is driven by keys, and there is no terminal to type them; nothing was energised")
    loaded = None if args.load is None else load_trajectory(args.load)
    configs = [
        with_likely_gripper(arm, calibration_path=arm.calibration, track_integral=True) for arm in each_arm(args)
    ]
    session = ArmSession(configs)
    if loaded is not None:
        loaded.check([session.hardware(config.name) for config in configs])
    tell(_hazard(configs))
    confirm_word(args.yes, _WORD, f"Type {_WORD} to go on:")
    with key_terminal() as terminal:
        try:
            session.start()
            FloatConsole(session, [config.name for config in configs], terminal, args.output, loaded).run()
        finally:
            landed = session.stop()
    return tell_landed(landed)


def _hazard(configs: Sequence[ArmConfig]) -> str:
    """Say what will happen, for the person who has to confirm it."""
    channels = " and ".join(config.channel for config in configs)
    text = (
        f"HAZARD: this energises the arm on {channels}. It floats: it weighs nothing to your hand, and stays where you "
        "let it go. A replay moves it by itself. Keep clear of its way, and the emergency stop within reach."
    )
    seeks = [config.name for config in configs if seeks_stops(config)]
    if seeks:
        text += f" The gripper of {' and '.join(seeks)} closes and opens fully to find its stops (see --calibration)."
    return text


if __name__ == "__main__":
    sys.exit(main())
