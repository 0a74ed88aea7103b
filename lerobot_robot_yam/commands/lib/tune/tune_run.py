"""Drives one arm for `yam-tune`: to measure, and once more to see how it holds with the tuning."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tuning.gravity_terms import GravityTerms
from lerobot_robot_yam.arm.tuning.tuning import Tuning
from lerobot_robot_yam.commands.lib.arm_command import ask, tell
from lerobot_robot_yam.commands.lib.tune.tune_fit import Fit, NotToldError, fit, torque_steps
from lerobot_robot_yam.commands.lib.tune.tune_motion import Holds, Samples, expected, sweep
from lerobot_robot_yam.commands.lib.tune.tune_plan import SPEED_RAD_S, Route, plan, shown
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.session.yam_arm import YamArm

LEGS = 12  # of an automatic run: 80 s
_HOLD_POSES = 4  # at which it is tried
_REMEDY_LEGS = 2
_GUIDED_MOST = 20
_LEAST_MOVED_RAD = 0.15  # of a joint, for its friction to show


class Tuner:
    """One arm that is tuned.

    Args:
        config: the arm, without a tuning.
        workspace: what its ways keep clear of.
        bare: its tuning without a payload, if a payload is sought.
        legs: ways of an automatic run, each gone there and back.

    Raises:
        ConfigError: it cannot be tuned so.
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
            bare.tuned(*profiles)
        self._terms = GravityTerms(*profiles, tilt_rad=hardware.tilt_rad)
        self._route = Route(hardware, workspace)

    def measure(self, guided: bool) -> tuple[Fit, Holds, np.ndarray]:
        """Move the arm; what it weighs and how it rubs, how it held, and the poses (k, n) rad that it went through.

        Raises:
            ConfigError: a pose would hit something, or the poses do not tell all; says which.
            YamError: the arm stops, is stopped or is silent.
        """
        with YamArm(self._config, isolation=self._isolation, start="hold") as arm:
            start = arm.observe().q
            if guided:
                poses = np.array(_led_poses(arm))
                here = arm.observe().setpoint_q
                self._route.check([here, poses[0], *poses[1:]])
                self._fit(expected(self.hardware, self._terms, poses), poses)
            else:
                poses = self._plan(start, self._legs)
            arm.move_to(poses[0], speed_rad_s=SPEED_RAD_S)
            samples, holds = sweep(arm, poses, _progress("measuring"))
        return self._fit(samples, poses), holds, poses

    def hold(self, tuning: Path, poses: np.ndarray) -> Holds:
        """How the arm holds with a tuning, at some of those poses."""
        few = poses[:_HOLD_POSES]
        tuned = {"tuning": str(tuning), "gravity_factor": None}
        with YamArm(self._config, isolation=self._isolation, start="hold", **tuned) as arm:
            arm.move_to(few[0], speed_rad_s=SPEED_RAD_S)
            return sweep(arm, few, _progress("trying"))[1]

    def _plan(self, start: np.ndarray, legs: int) -> np.ndarray:
        return plan(self.hardware, self._terms, self._route, start, torque_steps(self.hardware), legs)

    def _fit(self, samples: Samples, poses: np.ndarray) -> Fit:
        """Raises ConfigError: the samples do not tell all; says which poses would."""
        try:
            return fit(self.hardware, samples, self._bare)
        except NotToldError as error:
            moved, names = np.ptp(poses, axis=0), self.hardware.joint_names
            still = [f"{names[j]} by {moved[j]:.2f} rad" for j in error.joints if moved[j] < _LEAST_MOVED_RAD]
            more = " → ".join(map(shown, self._plan(poses[-1], _REMEDY_LEGS)))
            raise ConfigError(
                f"{error}{'; the poses move only ' * bool(still)}{', '.join(still)}. Poses that would, in rad: {more}. "
                "Nothing was written"
            ) from error


def _progress(doing: str) -> Callable[[float], None]:
    def say(share: float) -> None:
        tell(f"\r{doing}: {share:4.0%}", end="" if share < 1.0 else "\n")

    return say


def _led_poses(arm: YamArm) -> list[np.ndarray]:
    """Poses to which a person has led the floating arm; it holds afterwards."""
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
