"""Find out what an arm weighs and how it rubs, and write a tuning that its config names.

yam-tune --channel can_follower_l --out left.yaml                        ENERGISES the arm: slow ways there and back
yam-tune --channel can_follower_l --out left.yaml --guided               the same through poses that you lead it to
yam-tune --channel can_follower_l --out held.yaml --payload left.yaml    what its tool carries now, beside left.yaml

It asks first (--yes for scripts). Afterwards the arm moves once more, with the tuning, to show what it brings.
Ctrl-C lands the arm; the file is written at the very end or not at all.
"""

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.arm.tuning.tuning import load_tuning, save_tuning
from lerobot_robot_yam.commands.lib.arm_command import (
    add_arm_arguments,
    ask,
    need_terminal,
    run_command,
    tell,
    with_likely_gripper,
)
from lerobot_robot_yam.commands.lib.plot_file import require_plot
from lerobot_robot_yam.commands.lib.tune.least_squares import require_engine
from lerobot_robot_yam.commands.lib.tune.tune_plan import MARGIN_M, SPEED_RAD_S
from lerobot_robot_yam.commands.lib.tune.tune_report import report, save_plot
from lerobot_robot_yam.commands.lib.tune.tune_run import LEGS, Tuner
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.system.paths import user_path

_WORD = "tune"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-tune`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-tune", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_arm_arguments(parser)
    parser.add_argument("--out", type=user_path, required=True, metavar="PATH", help="the tuning to write")
    parser.add_argument("--force", action="store_true", help="replace the file at --out")
    parser.add_argument("--guided", action="store_true", help="the arm floats first, and you lead it to the poses")
    parser.add_argument("--payload", type=user_path, metavar="PATH", help="tuning of the bare arm: find the payload")
    parser.add_argument(
        "--floor-z", type=float, metavar="M", help="height of the table above the foot of the base (default 0)"
    )
    parser.add_argument(
        "--tilt", type=float, nargs=2, default=(0.0, 0.0), metavar="RAD", help="roll and pitch of the base (default 0)"
    )
    parser.add_argument(
        "--gravity-factor", type=float, nargs="+", metavar="F", help="per joint, as in the arm's config until now"
    )
    parser.add_argument("--calibration", metavar="PATH", help="the gripper's stored stops; they are not searched then")
    parser.add_argument("--plot", type=user_path, metavar="PATH", help="file for a picture, such as tuning.png")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    args = parser.parse_args(arguments)
    if args.guided and args.yes:
        parser.error("--guided needs a person, so it excludes --yes")
    return run_command("yam-tune", lambda: _tune(args))


def _tune(args: argparse.Namespace) -> int:
    need_terminal(args.yes)
    if any(args.tilt) and args.floor_z is None:
        raise ConfigError("with --tilt say where the table is: --floor-z, its height above the foot of the base, m")
    fields = {
        "base_tilt_rad": list(args.tilt),
        "calibration_path": args.calibration,
        "gravity_factor": args.gravity_factor,
    }
    config = with_likely_gripper(args, **fields)
    tell(hazard(config, args.guided))
    if not args.yes and ask(f"Clear the space around the arm, then type {_WORD} to go on:") != _WORD:
        raise ConfigError("not confirmed; nothing was energised")
    return tune(config, args)


def hazard(config: ArmConfig, guided: bool) -> str:
    """What will happen, for the person who has to confirm it."""
    first = "floats so that you can lead it by hand, then goes" if guided else "goes"
    path = config.calibration_path
    searches = ""
    if load_gripper(config.gripper).motor is not None and (path is None or not Path(path).exists()):
        searches = " Its gripper closes and opens fully to find its stops (--calibration avoids that)."
    return (
        f"HAZARD: this energises the arm on channel {config.channel}, which {first} through poses all over its range, "
        f"at up to {SPEED_RAD_S} rad/s, for 2 minutes, lands, rises once more and lands. It keeps {MARGIN_M * 1e3:.0f} "
        "mm from the table and from itself; it knows of nothing else in its way. Keep hands off all arms and the "
        f"emergency stop within reach.{searches}"
    )


def tune(config: ArmConfig, args: argparse.Namespace, isolation: Isolation = "process", legs: int = LEGS) -> int:
    """Measure, fit, try and write; returns the exit status.

    Args:
        config: the arm, without a tuning.
        args: out, force, guided, payload, floor_z and plot of the command line.
        isolation, legs: see `Tuner`.

    Raises:
        YamError: what failed; the arm has landed or was never energised, and nothing was written.
    """
    require_engine()
    if args.plot is not None:
        require_plot()
    if args.out.exists() and not args.force:
        raise ConfigError(f"{args.out} exists; give --force to replace it")
    bare = None if args.payload is None else load_tuning(args.payload)
    workspace = WorkspaceConfig(floor_z_m=(args.floor_z or 0.0) + MARGIN_M, collision_margin_m=MARGIN_M)
    tuner = Tuner(dataclasses.replace(config, hold_integral=False), isolation, workspace, bare, legs)
    found, before, poses = tuner.measure(args.guided)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tuning.yaml"
        save_tuning(path, found.tuning)
        after = tuner.hold(path, poses)
    save_tuning(args.out, found.tuning)
    sys.stdout.write(report(tuner.hardware, found, before, after) + f"\ntuning: {args.out}\n")
    if args.plot is not None:
        save_plot(args.plot, tuner.hardware, found, before, after)
        sys.stdout.write(f"picture: {args.plot}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
