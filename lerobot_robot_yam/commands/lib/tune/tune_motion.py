"""Motions that identify an arm's weight and friction: planned clear of table and arm, and made in both directions.

Each next pose is the random candidate whose motion increases the log-determinant of the information most per second
(D-optimal design).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.collision.clearance import Clearance, Conflict
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.tune.gravity_terms import GravityTerms
from lerobot_robot_yam.damiao.codec import torque_step_nm
from lerobot_robot_yam.errors import ConfigError, LifeCycleError
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.modes import Mode

SPEED_RAD_S = 0.55  # maximum speed of a joint, rad/s: inertia is negligible, and friction exceeds the noise
MARGIN_M = 0.03  # minimum distance to table and arm, m: the tool may sag by this much while the weight is unknown
RAMP_S = 0.3  # time from rest to full speed, s
WAIT_S = 0.5  # rest at each pose, s
_TURN_RAD = 0.6  # maximum turn of the base to either side of its start angle, rad
_FROM_STOPS_RAD = 0.1
_MOVED_RAD = 0.25  # minimum travel of each joint per path segment, rad, so that its friction is measurable
_CANDIDATES = 60  # candidates for the next pose
_TRIES = 5  # maximum number of candidate sets until a path segment is clear
_LOOKS = 200  # maximum number of collision checks per path segment
_POINTS = np.linspace(0.1, 0.9, 5)  # positions along a path segment, as shares, at which its information is computed
_WEAK = 1e-3  # initial information about each moment, (kg m)⁻²: makes the determinant positive
_PERIOD_S = 0.02  # period of sending targets, s
_LOOK_S = 0.002  # period of reading states, s: short, so that the mean torques include every tick
_SETTLE_S = 0.15  # time after the ramp until the joints move steadily, s
_EXPECTED_STEPS = 20  # simulated samples per path segment
_BIN_S = 0.1  # averaging time of a sample, s: single torques are quantised, see `damiao.codec`


class Samples(NamedTuple):
    """Measurements of n joints at k times, each averaged over `_BIN_S`.

    Attributes:
        q, dq, ddq: (k, n) angles, speeds and accelerations, rad, rad/s, rad/s².
        tau: (k, n) torques that the motors report, Nm.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray


class Route:
    """Planner of straight joint-space paths that are clear of obstacles.

    Args:
        hardware: the arm.
        terms: moments on which the arm's weight depends.
        workspace: floor and boxes to keep clear of, and the margin.
    """

    def __init__(self, hardware: ResolvedArm, terms: GravityTerms, workspace: WorkspaceConfig):
        arm = GuardedArm(hardware.name, hardware.arm, hardware.gripper, workspace, hardware.tilt_rad)
        self._clearance = Clearance([arm])
        self._hardware, self._terms = hardware, terms

    def _conflict(self, start: np.ndarray, end: np.ndarray) -> Conflict | None:
        """Return the worst conflict on the straight path between two poses (n,) rad, or None if the path is clear."""
        found = self._clearance.conflicts(start, end, most_steps=_LOOKS)
        return found[0] if found else None

    def check(self, poses: Sequence[np.ndarray]) -> None:
        """Check that the path through poses (n,) rad is clear. Raises ConfigError: two parts would come too close."""
        names = self._clearance.parts.part_names
        for number, (start, end) in enumerate(zip(poses, poses[1:], strict=False), 1):
            if (found := self._conflict(start, end)) is not None:
                first, second = names[found.pair.first], names[found.pair.second]
                raise ConfigError(
                    f"{self._hardware.name}: on the way to pose {number} {first} would come within "
                    f"{max(found.there_m, 0.0) * 1e3:.0f} mm of {second} ({shown(end)}); leave that pose out, or "
                    "begin with the arm elsewhere"
                )

    def plan(self, start: np.ndarray, legs: int) -> np.ndarray:
        """Return poses (legs + 1, n) rad of a path that the arm can reach from `start` (n,) rad.

        Raises:
            ConfigError: no candidate can be reached on a clear path.
        """
        random = np.random.default_rng(0)
        low, high = (self._hardware.arm.joint_limits_rad + [_FROM_STOPS_RAD, -_FROM_STOPS_RAD]).T
        base = self._hardware.folding.base
        if base is not None:
            low[base], high[base] = max(low[base], start[base] - _TURN_RAD), min(high[base], start[base] + _TURN_RAD)
        known = _WEAK * np.eye(len(self._terms.terms))
        poses = [start]
        while len(poses) < legs + 2:
            sets = (random.uniform(low, high, (_CANDIDATES, len(low))) for _ in range(_TRIES))
            found = next((best for candidates in sets if (best := self._best(candidates, poses[-1], known))), None)
            if found is None:
                raise ConfigError(
                    f"{self._hardware.name}: no pose can be reached from {shown(poses[-1])} without coming within "
                    f"{MARGIN_M * 1e3:.0f} mm of the table or of the arm itself; begin with the arm elsewhere"
                )
            poses.append(found[0])
            known = known + found[1]
        return np.array(poses[1:])

    def _best(
        self, candidates: np.ndarray, here: np.ndarray, known: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the best candidate (n,) of (c, n) with a clear path, and its information; None: no path is clear."""
        least = np.linalg.slogdet(known)[1]
        scored = []
        for there in candidates:
            if np.abs(there - here).min() >= _MOVED_RAD:
                told = self._information(here + _POINTS[:, None] * (there - here))
                gain = (np.linalg.slogdet(known + told)[1] - least) / (way_s(here, there) + WAIT_S)
                scored.append((gain, there, told))
        for _, there, told in sorted(scored, key=lambda row: -row[0]):
            if self._conflict(here, there) is None:
                return there, told
        return None

    def _information(self, way: np.ndarray) -> np.ndarray:
        """Return the information (p, p) that poses (k, n) rad give about the moments; unit of error: a torque step."""
        steps_nm = torque_steps(self._hardware)[:, None]
        rows = [self._terms.moments(q) / steps_nm for q in way]
        return np.sum([row.T @ row for row in rows], axis=0)


def torque_steps(hardware: ResolvedArm) -> np.ndarray:
    """Return the steps (n,) in which the joints' motors report torque, Nm."""
    return np.array([torque_step_nm(motor.type) for motor in hardware.motors[: hardware.joints]])


def shown(q: np.ndarray) -> str:
    """Format a pose (n,) rad as a list."""
    return "[" + ", ".join(f"{value:.2f}" for value in q) + "]"


def way_s(start: np.ndarray, end: np.ndarray) -> float:
    """Return the duration of a path segment, s, at up to `SPEED_RAD_S` with ramps of `RAMP_S` at both ends."""
    return float(np.abs(end - start).max()) / SPEED_RAD_S + RAMP_S


def _there_and_back(poses: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return [*zip(poses, poses[1:], strict=False), *zip(poses[::-1], poses[-2::-1], strict=False)]


def sweep(arm: YamArm, poses: np.ndarray, tell: Callable[[float], None]) -> tuple[Samples, np.ndarray]:
    """Move through poses (k, n) rad and back to the first pose, where the arm stays.

    Args:
        arm: connected arm, at the first pose.
        tell: called with the completed share of the path.

    Returns:
        Samples, and the deviations from the set-point at each rest, (m, n) rad.

    Raises:
        YamError: the arm faults or is stopped, or its control loop is silent.
    """
    legs = _there_and_back(poses)
    parts, errors = [], []
    for number, (start, end) in enumerate(legs, 1):
        parts.append(_leg(arm, start, end))
        state = arm.observe()
        errors.append(state.setpoint_q - state.q)
        tell(number / len(legs))
    return Samples(*map(np.concatenate, zip(*parts, strict=True))), np.array(errors)


def _leg(arm: YamArm, start: np.ndarray, end: np.ndarray) -> Samples:
    """Move straight at a steady speed, and come to rest; return samples of the steady part."""
    clock, seconds = arm.clock, way_s(start, end)
    rows: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []
    begin, due = clock.now(), 0.0
    while (now := clock.now() - begin) < seconds + WAIT_S:
        if now >= due:
            share, rate = _ramped(now, seconds)
            arm.command(start + share * (end - start), dq=rate * (end - start))
            due = now + _PERIOD_S
        state = arm.observe()
        if state.mode not in (Mode.HOLD, Mode.TRACK):
            raise LifeCycleError(f"{arm.config.name}: the arm is in mode {state.mode.name.lower()}; nothing was kept")
        steady = RAMP_S + _SETTLE_S < now < seconds - RAMP_S
        if steady and (not rows or state.stamp_s > rows[-1][0]):
            rows.append((state.stamp_s, state.q, state.dq, state.tau_nm))
        clock.sleep(_LOOK_S)
    times, q, dq, tau = (np.array(column) for column in zip(*rows, strict=True))
    bins = ((times - times[0]) / _BIN_S).astype(int)
    times, q, dq, tau = (
        np.array([values[bins == b].mean(axis=0) for b in np.unique(bins)]) for values in (times, q, dq, tau)
    )
    return Samples(q, dq, np.gradient(dq, times, axis=0), tau)


def _ramped(now: float, seconds: float) -> tuple[float, float]:
    """Return the completed share of a path segment at `now`, and its rate, 1/s. `seconds`: duration, ramps included."""
    top = 1.0 / (seconds - RAMP_S)
    left = max(seconds - now, 0.0)
    if now < RAMP_S:
        return 0.5 * top * now**2 / RAMP_S, top * now / RAMP_S
    if left < RAMP_S:
        return 1.0 - 0.5 * top * left**2 / RAMP_S, top * left / RAMP_S
    return top * (now - 0.5 * RAMP_S), top


def expected(hardware: ResolvedArm, model: GravityModel, poses: np.ndarray) -> Samples:
    """Simulate the samples of a sweep through poses (k, n) rad with an arm as modelled, without friction.

    The torques have random errors of about one torque step, so a fit shows what the sweep would leave unknown.
    """
    shares = np.arange(_EXPECTED_STEPS)[:, None] / _EXPECTED_STEPS
    ways = _there_and_back(poses)
    q = np.concatenate([start + shares * (end - start) for start, end in ways])
    dq = np.concatenate([np.tile((end - start) / way_s(start, end), (_EXPECTED_STEPS, 1)) for start, end in ways])
    noise = np.random.default_rng(0).normal(size=q.shape) * torque_steps(hardware)
    still = np.zeros_like(q)
    tau = [np.add(*model.torques(*row)[:2]) for row in zip(q, dq, still, strict=True)]
    return Samples(q, dq, still, np.array(tau) + noise)
