"""Ways that tell an arm's weight and friction: planned clear of the table and of the arm, and gone there and back.

The next pose is always the one, of some random ones, whose way adds most to what the data will tell: the largest
growth of the determinant of the information (D-optimal design), per second of the way.
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

SPEED_RAD_S = 0.55  # the most of any joint; slow, so that inertia hardly counts, and friction is more than the noise
MARGIN_M = 0.03  # from the table and from itself: as much as the tool sags while the weight is unknown
RAMP_S = 0.3  # from rest to full speed
WAIT_S = 0.5  # at each pose
_TURN_RAD = 0.6  # of the base to either side, from where it stands
_FROM_STOPS_RAD = 0.1
_MOVED_RAD = 0.25  # least of each joint on a way: it shows its friction
_CANDIDATES = 60  # poses to choose the next one from
_TRIES = 5  # sets of candidates until a way is clear
_LOOKS = 200  # along a way
_POINTS = np.linspace(0.1, 0.9, 5)  # of a way, at which its information is judged
_WEAK = 1e-3  # information, (kg m)⁻² and the like, to begin with
_PERIOD_S = 0.02  # of the targets
_LOOK_S = 0.002  # no tick's state is missed: what a motor feels changes from tick to tick, and only the mean counts
_SETTLE_S = 0.15  # after which the joints move as steadily as they are told to
_EXPECTED_STEPS = 20  # of a way
_BIN_S = 0.1  # what is averaged: the torques that are fed back have steps, see `damiao.codec`


class Samples(NamedTuple):
    """Averages over `_BIN_S`, of k moments and n joints.

    Attributes:
        q, dq, ddq: (k, n) rad, rad/s, rad/s².
        tau: (k, n) Nm, what the motors feel.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray


class Route:
    """Plans straight ways of an arm, and tells which are clear.

    Args:
        hardware: the arm.
        terms: what its weight depends on.
        workspace: floor, boxes and margin that it keeps.
    """

    def __init__(self, hardware: ResolvedArm, terms: GravityTerms, workspace: WorkspaceConfig):
        arm = GuardedArm(hardware.name, hardware.arm, hardware.gripper, workspace, hardware.tilt_rad)
        self._clearance = Clearance([arm])
        self._hardware, self._terms = hardware, terms

    def _conflict(self, start: np.ndarray, end: np.ndarray) -> Conflict | None:
        """Return the worst conflict on the way between two poses (n,) rad, None where the way is clear."""
        found = self._clearance.conflicts(start, end, most_steps=_LOOKS)
        return found[0] if found else None

    def check(self, poses: Sequence[np.ndarray]) -> None:
        """Refuse a way through poses (n,) rad that hits something. Raises ConfigError: says where, and what."""
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
        """Choose poses (legs + 1, n) rad of a way for an arm that lies or stands at `start` (n,) rad.

        Raises:
            ConfigError: no way is clear.
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
        """Return the candidate (n,) of (c, n) with a clear way that tells most, and what it tells; None: no way is."""
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
        """Return (p, p): what a way (k, n) rad tells about the moments, in units of the steps of measured torques."""
        steps_nm = torque_steps(self._hardware)[:, None]
        rows = [self._terms.moments(q) / steps_nm for q in way]
        return np.sum([row.T @ row for row in rows], axis=0)


def torque_steps(hardware: ResolvedArm) -> np.ndarray:
    """Return (n,) Nm, the steps in which the joints' motors tell their torque."""
    return np.array([torque_step_nm(motor.type) for motor in hardware.motors[: hardware.joints]])


def shown(q: np.ndarray) -> str:
    """Write a pose (n,) rad as a list."""
    return "[" + ", ".join(f"{value:.2f}" for value in q) + "]"


def way_s(start: np.ndarray, end: np.ndarray) -> float:
    """Return the time of a way at `SPEED_RAD_S` at most, with `RAMP_S` to speed up and as long to slow down."""
    return float(np.abs(end - start).max()) / SPEED_RAD_S + RAMP_S


def _there_and_back(poses: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return [*zip(poses, poses[1:], strict=False), *zip(poses[::-1], poses[-2::-1], strict=False)]


def sweep(arm: YamArm, poses: np.ndarray, tell: Callable[[float], None]) -> tuple[Samples, np.ndarray]:
    """Go through poses (k, n) rad and back to the first one; the arm stands there at the end.

    Args:
        arm: connected, and at the first pose.
        tell: called with the share of the way that is done.

    Returns:
        Samples, and (m, n) rad: how far the arm hung off its set-point where it rested.

    Raises:
        YamError: the arm stops, is stopped or is silent.
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
    """Go a straight way at a steady speed, and come to rest; return samples of the steady part."""
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
    """Return the share of a way, and its rate in 1/s, that takes `seconds` with ramps of `RAMP_S` at both ends."""
    top = 1.0 / (seconds - RAMP_S)
    left = max(seconds - now, 0.0)
    if now < RAMP_S:
        return 0.5 * top * now**2 / RAMP_S, top * now / RAMP_S
    if left < RAMP_S:
        return 1.0 - 0.5 * top * left**2 / RAMP_S, top * left / RAMP_S
    return top * (now - 0.5 * RAMP_S), top


def expected(hardware: ResolvedArm, model: GravityModel, poses: np.ndarray) -> Samples:
    """Return what a sweep through poses (k, n) rad would bring of an arm as the model has it, without friction.

    Its torques err by a step of the motors' feedback, so that a fit shows what the sweep would leave unknown.
    """
    shares = np.arange(_EXPECTED_STEPS)[:, None] / _EXPECTED_STEPS
    ways = _there_and_back(poses)
    q = np.concatenate([start + shares * (end - start) for start, end in ways])
    dq = np.concatenate([np.tile((end - start) / way_s(start, end), (_EXPECTED_STEPS, 1)) for start, end in ways])
    noise = np.random.default_rng(0).normal(size=q.shape) * torque_steps(hardware)
    still = np.zeros_like(q)
    tau = [np.add(*model.torques(*row)[:2]) for row in zip(q, dq, still, strict=True)]
    return Samples(q, dq, still, np.array(tau) + noise)
