"""Measure an arm's weight and friction, and write a tuning file for the arm's config.

yam-tune --channel can_follower_l --out left.yaml                        ENERGISES the arm: slow ways there and back
yam-tune --channel can_follower_l --out left.yaml --guided               the same through poses that you lead it to
yam-tune --channel can_follower_l --out held.yaml --payload left.yaml    what its tool carries now, beside left.yaml

The command asks first (--yes for scripts). Afterwards the arm moves once more, with the tuning, to show its effect.
Ctrl-C lands the arm; the file is written at the very end or not at all.
"""

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import seeks_stops
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tuning import Tuning, load_tuning, save_tuning
from lerobot_robot_yam.commands.lib.arm_command import add_arm_arguments, with_likely_gripper
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import ask, confirm_word, need_terminal, say, tell
from lerobot_robot_yam.commands.lib.plot_file import require_plot
from lerobot_robot_yam.commands.lib.tune.gravity_terms import GravityTerms
from lerobot_robot_yam.commands.lib.tune.tune_fit import Fit, NotToldError, fit, require_engine
from lerobot_robot_yam.commands.lib.tune.tune_motion import (
    MARGIN_M,
    SPEED_RAD_S,
    Route,
    Samples,
    expected,
    shown,
    sweep,
)
from lerobot_robot_yam.commands.lib.tune.tune_report import report, save_plot
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.system.paths import user_path

LEGS = 12  # path segments of an automatic run, which takes 80 s
_WORD = "tune"
_HOLD_POSES = 4  # poses at which the new tuning is tested
_REMEDY_LEGS = 2
_GUIDED_MOST = 20
_LEAST_MOVED_RAD = 0.15  # minimum travel of a joint for determining its friction, rad


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-tune`; return its exit status."""
    parser = command_parser("yam-tune", __doc__)
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
    config = with_likely_gripper(
        args,
        base_tilt_rad=list(args.tilt),
        calibration_path=args.calibration,
        gravity_factor=args.gravity_factor,
    )
    first = "floats so that you can lead it by hand, then goes" if args.guided else "goes"
    seeks = " Its gripper closes and opens fully to find its stops (--calibration avoids that)."
    tell(
        f"HAZARD: this energises the arm on channel {config.channel}, which {first} through poses all over its range, "
        f"at up to {SPEED_RAD_S} rad/s, for 2 minutes, lands, rises once more and lands. It keeps {MARGIN_M * 1e3:.0f} "
        "mm from the table and from itself; it knows of nothing else in its way. Keep hands off all arms and the "
        f"emergency stop within reach.{seeks if seeks_stops(config) else ''}"
    )
    confirm_word(args.yes, _WORD, f"Clear the space around the arm, then type {_WORD} to go on:")
    return tune(config, args)


def tune(config: ArmConfig, args: argparse.Namespace, isolation: Isolation = "process", legs: int = LEGS) -> int:
    """Measure an arm, then fit, test and write its tuning; return the exit status.

    Args:
        config: the arm, without a tuning.
        args: command-line arguments out, force, guided, payload, floor_z and plot.
        isolation, legs: see `Tuner`.

    Raises:
        YamError: a step failed; the arm has landed or was never energised, and nothing was written.
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
    after = tuner.hold(found.tuning, poses)
    save_tuning(args.out, found.tuning)
    say(report(tuner.hardware, found, before, after) + f"\ntuning: {args.out}")
    if args.plot is not None:
        save_plot(args.plot, tuner.hardware, found, before, after)
        say(f"picture: {args.plot}")
    return 0


class Tuner:
    """Measurement of one arm: its weight and friction, then its hold errors with the tuning.

    Args:
        config: the arm, without a tuning.
        isolation: where the arm's control loop runs, see `ArmSession`.
        workspace: obstacles that the arm's motions keep clear of.
        bare: tuning of the arm without a payload; if given, only the payload and friction are fitted.
        legs: path segments of an automatic run; the arm moves along each segment in both directions.

    Raises:
        ConfigError: the arm cannot be tuned with these arguments.
    """

    def __init__(
        self, config: ArmConfig, isolation: Isolation, workspace: WorkspaceConfig, bare: Tuning | None, legs: int = LEGS
    ):
        self._config, self._isolation, self._bare, self._legs = config, isolation, bare, legs
        self.hardware = hardware = ResolvedArm(config)
        if not hardware.joints:
            raise ConfigError(f"{config.name}: arm {config.arm!r} has no joints to tune")
        profiles = hardware.arm, hardware.gripper
        if bare is not None:
            bare.tuned(*profiles)  # raises if the tuning belongs to another arm
        self._terms = GravityTerms(*profiles, tilt_rad=hardware.tilt_rad)
        self._route = Route(hardware, self._terms, workspace)

    def measure(self, guided: bool) -> tuple[Fit, np.ndarray, np.ndarray]:
        """Move the arm; return the fit, the hold errors (m, n) rad, and the poses (k, n) rad.

        Raises:
            ConfigError: a path would hit something, or the poses leave a parameter unknown; the message says which.
            YamError: the arm faults or is stopped, or its control loop is silent.
        """
        with YamArm(self._config, isolation=self._isolation, start="hold") as arm:
            start = arm.observe().q
            if guided:
                poses = np.array(_led_poses(arm))
                self._route.check([arm.observe().setpoint_q, *poses])
                self._fit(expected(self.hardware, self._terms, poses), poses)
            else:
                poses = self._route.plan(start, self._legs)
            arm.move_to(poses[0], speed_rad_s=SPEED_RAD_S)
            samples, holds = sweep(arm, poses, partial(_progress, "measuring"))
        return self._fit(samples, poses), holds, poses

    def hold(self, tuning: Tuning, poses: np.ndarray) -> np.ndarray:
        """Hold the arm with a tuning at the first poses; return the joints' deviations from set-points, (m, n) rad."""
        few = poses[:_HOLD_POSES]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "tuning.yaml"
            save_tuning(path, tuning)
            tuned = {"tuning": str(path), "gravity_factor": None}
            with YamArm(self._config, isolation=self._isolation, start="hold", **tuned) as arm:
                arm.move_to(few[0], speed_rad_s=SPEED_RAD_S)
                return sweep(arm, few, partial(_progress, "trying"))[1]

    def _fit(self, samples: Samples, poses: np.ndarray) -> Fit:
        """Fit the samples. Raises ConfigError: a parameter stays unknown; the message lists poses to add."""
        try:
            return fit(self.hardware, samples, self._bare)
        except NotToldError as error:
            moved, names = np.ptp(poses, axis=0), self.hardware.joint_names
            still = [f"{names[j]} by {moved[j]:.2f} rad" for j in error.joints if moved[j] < _LEAST_MOVED_RAD]
            more = " → ".join(map(shown, self._route.plan(poses[-1], _REMEDY_LEGS)))
            raise ConfigError(
                f"{error}{'; the poses move only ' * bool(still)}{', '.join(still)}. Poses that would, in rad: {more}. "
                "Nothing was written"
            ) from error


def _progress(doing: str, share: float) -> None:
    tell(f"\r{doing}: {share:4.0%}", end="" if share < 1.0 else "\n")


def _led_poses(arm: YamArm) -> list[np.ndarray]:
    """Return the poses to which the user leads the floating arm; the arm holds afterwards."""
    tell("The arm floats. Lead it to poses that are clear of everything; the ways between them will be straight.")
    arm.float()
    poses: list[np.ndarray] = []
    while len(poses) < _GUIDED_MOST:
        if ask(f"pose {len(poses) + 1}: Enter to keep it, or d and Enter when all are done:") == "d":
            break
        poses.append(arm.observe().q)
        tell(f"  {shown(poses[-1])}")
    arm.hold()
    if len(poses) < 2:
        raise ConfigError(f"{arm.config.name}: {len(poses)} poses are no way; give two at least, better eight")
    return poses


if __name__ == "__main__":
    sys.exit(main())
