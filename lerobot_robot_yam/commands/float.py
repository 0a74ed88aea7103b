"""Let one or two arms float, carried against gravity; record what your hand does with them, and replay it.

yam-float --channel can_follower_l                                   one arm, by keys
yam-float --channel can_follower_l can_follower_r                    two arms, recorded and replayed together
yam-float --channel can_follower_l --load wave.npy --output new.npy  what l and s read and write

HAZARD: this ENERGISES the arms. Files are of the form of the vendor's example. However it ends, the arms land.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.arm_command import (
    add_arm_arguments,
    ask,
    each_arm,
    run_command,
    tell,
    tell_landed,
    with_likely_gripper,
)
from lerobot_robot_yam.commands.lib.float_console import FloatConsole
from lerobot_robot_yam.commands.lib.key_terminal import key_terminal
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.session.trajectory_file import load_trajectory
from lerobot_robot_yam.system.paths import user_path

_WORD = "float"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-float`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-float", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
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
    if not sys.stdin.isatty():
        raise ConfigError("it is driven by keys, and there is no terminal to type them; nothing was energised")
    loaded = None if args.load is None else load_trajectory(args.load)
    configs = [
        with_likely_gripper(arm, calibration_path=arm.calibration, track_integral=True) for arm in each_arm(args)
    ]
    hardware = [ResolvedArm(config) for config in configs]
    if loaded is not None:
        loaded.check(hardware)
    session = ArmSession(configs)
    tell(_hazard(hardware))
    if not args.yes and ask(f"Type {_WORD} to go on:") != _WORD:
        raise ConfigError("not confirmed; nothing was energised")
    return tell_landed(_drive(session, configs, args.output, loaded))


def _drive(session: ArmSession, configs: Sequence[ArmConfig], output: Path, loaded: Trajectory | None) -> bool:
    """Energise the arms, do as the keys say, and land them however that ends; returns whether they are down."""
    with key_terminal() as terminal:
        try:
            session.start()
            FloatConsole(session, [config.name for config in configs], terminal, output, loaded).run()
        finally:
            landed = session.stop()
    return landed


def _hazard(arms: Sequence[ResolvedArm]) -> str:
    """What will happen, for the person who has to confirm it."""
    channels = " and ".join(arm.config.channel for arm in arms)
    text = (
        f"HAZARD: this energises the arm on {channels}. It floats: it weighs nothing to your hand, and stays where you "
        "let it go. A replay moves it by itself. Keep clear of its way, and the emergency stop within reach."
    )
    seeks = [arm.name for arm in arms if arm.has_gripper and not _stored(arm)]
    if seeks:
        text += f" The gripper of {' and '.join(seeks)} closes and opens fully to find its stops (see --calibration)."
    return text


def _stored(arm: ResolvedArm) -> bool:
    path = arm.config.calibration_path
    return path is not None and Path(path).exists()


if __name__ == "__main__":
    sys.exit(main())
