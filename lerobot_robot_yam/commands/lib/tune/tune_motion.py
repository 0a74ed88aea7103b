"""Leads an arm along a way, there and back, and notes what its joints do and what its motors feel."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.tune.tune_plan import RAMP_S, WAIT_S, way_s
from lerobot_robot_yam.damiao.codec import torque_step_nm
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.modes import Mode

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


class Holds(NamedTuple):
    """How far an arm hangs off its set-point (m, n) rad where it rests, at poses (m, n) rad."""

    q: np.ndarray
    error_rad: np.ndarray


def sweep(arm: YamArm, poses: np.ndarray, tell: Callable[[float], None]) -> tuple[Samples, Holds]:
    """Go through poses (k, n) rad and back to the first one; the arm stands there at the end.

    Args:
        arm: connected, and at the first pose.
        tell: called with the share of the way that is done.

    Raises:
        YamError: the arm stops, is stopped or is silent.
    """
    legs = [*zip(poses, poses[1:], strict=False), *zip(poses[::-1], poses[-2::-1], strict=False)]
    parts, ends, errors = [], [], []
    for number, (start, end) in enumerate(legs, 1):
        parts.append(_leg(arm, start, end))
        state = arm.observe()
        ends.append(end)
        errors.append(state.setpoint_q - state.q)
        tell(number / len(legs))
    return Samples(*map(np.concatenate, zip(*parts, strict=True))), Holds(np.array(ends), np.array(errors))


def _leg(arm: YamArm, start: np.ndarray, end: np.ndarray) -> Samples:
    """A straight way at a steady speed, and some time to come to rest; samples of the steady part."""
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
    means = [np.array([values[bins == b].mean(axis=0) for b in np.unique(bins)]) for values in (times, q, dq, tau)]
    return Samples(means[1], means[2], np.gradient(means[2], means[0], axis=0), means[3])


def _ramped(now: float, seconds: float) -> tuple[float, float]:
    """Share of a way, and its rate in 1/s, that takes `seconds` with ramps of `RAMP_S` at both ends."""
    top = 1.0 / (seconds - RAMP_S)
    left = max(seconds - now, 0.0)
    if now < RAMP_S:
        return 0.5 * top * now**2 / RAMP_S, top * now / RAMP_S
    if left < RAMP_S:
        return 1.0 - 0.5 * top * left**2 / RAMP_S, top * left / RAMP_S
    return top * (now - 0.5 * RAMP_S), top


def expected(hardware: ResolvedArm, model: GravityModel, poses: np.ndarray) -> Samples:
    """What a sweep through poses (k, n) rad would bring of an arm as the model has it, without friction.

    Its torques err by a step of the motors' feedback, so that a fit shows what the sweep would leave unknown.
    """
    shares = np.arange(_EXPECTED_STEPS)[:, None] / _EXPECTED_STEPS
    there = list(zip(poses, poses[1:], strict=False))
    ways = there + [(end, start) for start, end in there]
    q = np.concatenate([start + shares * (end - start) for start, end in ways])
    dq = np.concatenate([np.tile((end - start) / way_s(start, end), (_EXPECTED_STEPS, 1)) for start, end in ways])
    steps = np.array([torque_step_nm(motor.type) for motor in hardware.motors[: hardware.joints]])
    noise = np.random.default_rng(0).normal(size=q.shape) * steps
    still = np.zeros_like(q)
    tau = [np.add(*model.torques(*row)[:2]) for row in zip(q, dq, still, strict=True)]
    return Samples(q, dq, still, np.array(tau) + noise)
