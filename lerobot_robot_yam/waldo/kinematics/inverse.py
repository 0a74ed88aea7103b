"""Inverse kinematics of many poses at once, with numpy alone: damped Newton steps within the joints' limits.

    Δq = argmin |W (J Δq − e)|² + μ |Δq|²        e = (position, rotation vector) from where it is to the target

μ falls with the error, so that the last steps are Newton's; a step that does not help is taken back and damped more.
A joint at its limit that would leave it is left out of the step. All poses take their steps together: a probe of 24
directions costs hardly more than one.
"""

from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.waldo.kinematics.rotation import to_turn
from lerobot_robot_yam.waldo.kinematics.serial_chain import SerialChain

TOLERANCE_M, TOLERANCE_RAD = 2e-5, 2e-5
"""How near a solution is: a fifth of what is promised."""

_LEVER_M = 0.2  # position error that counts as one radian: half an arm's length
_ITERATIONS = 40
_DONE = 1e-16  # of the squared error, m²: 10 nm
_STEP_RAD = 0.5  # farther than this the linearisation is not believed
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-7, 1e4
_FLOOR = 1e-14
_STARTS = 48  # tried together when the way from the seed ends elsewhere


class Solutions(NamedTuple):
    """Of m poses: q (m, n) rad within the limits; errors position_m and turn_rad (m,); whether they were reached."""

    q: np.ndarray
    position_m: np.ndarray
    turn_rad: np.ndarray

    @property
    def reached(self) -> np.ndarray:
        """(m,) bool."""
        return (self.position_m <= TOLERANCE_M) & (self.turn_rad <= TOLERANCE_RAD)


class Bounds(NamedTuple):
    """Of the joints: lower and upper (n,) rad."""

    lower: np.ndarray
    upper: np.ndarray


def descend(chain: SerialChain, targets: np.ndarray, seeds: np.ndarray, bounds: Bounds | None = None) -> Solutions:
    """From seeds (m, n) rad to flange poses (m, 4, 4), each on its own; to where the error grows no smaller.

    A target that is not finite is never reached, and no error. Without bounds those of the arm hold.
    """
    lower, upper = bounds or (chain.lower, chain.upper)
    targets = np.where(np.isfinite(targets), targets, np.nan)  # nan makes no noise on its way
    q = np.clip(seeds, lower, upper)
    error, jacobian = _residual(chain, targets, q)
    cost = _squares(error)
    damping = np.full(len(q), _DAMPING)
    for _ in range(_ITERATIONS):
        active = np.flatnonzero((cost > _DONE) & (damping < _MOST_DAMPING))  # a cost that is NaN is none of them
        if not active.size:
            break
        at_ends = q[active] <= lower, q[active] >= upper
        step = _step(at_ends, error[active], jacobian[active], damping[active] * np.minimum(cost[active], 1.0))
        there = np.clip(q[active] + step, lower, upper)
        there_error, there_jacobian = _residual(chain, targets[active], there)
        there_cost = _squares(there_error)
        better = there_cost < cost[active]
        gained = active[better]
        q[gained], error[gained], jacobian[gained] = there[better], there_error[better], there_jacobian[better]
        cost[gained] = there_cost[better]
        damping[active] = np.where(
            better, np.maximum(damping[active] / 8.0, _LEAST_DAMPING), np.maximum(damping[active], 1e-2) * 10.0
        )
    finite = np.isfinite(cost)
    off = np.where(finite[:, None], error, np.inf)
    return Solutions(q, np.sqrt(_squares(off[:, :3])), np.sqrt(_squares(off[:, 3:])) / _LEVER_M)


def solve(chain: SerialChain, target: np.ndarray, seed: np.ndarray) -> Solutions:
    """One flange pose (4, 4), from a seed (n,) rad, and where that fails from elsewhere too: the nearest solution.

    Returns:
        One solution, m = 1; one that was not reached is where the descent from the seed ended.
    """
    first = descend(chain, target[None], seed[None])
    if first.reached[0] or not np.isfinite(target).all():
        return first
    starts = np.random.default_rng(1).uniform(chain.lower, chain.upper, size=(_STARTS, chain.n))
    others = descend(chain, np.repeat(target[None], _STARTS, axis=0), starts)
    reached = np.flatnonzero(others.reached)
    if not reached.size:
        return first
    best = reached[np.abs(others.q[reached] - seed).max(axis=1).argmin()]
    return Solutions(*(column[best : best + 1] for column in others))


def _residual(chain: SerialChain, targets: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m, 6) W e and (m, 6, n) W J."""
    pose, jacobian = chain.place(q)
    error = np.empty((len(q), 6))
    error[:, :3] = targets[:, :3, 3] - pose[:, :3, 3]
    error[:, 3:] = _LEVER_M * to_turn(targets[:, :3, :3] @ np.swapaxes(pose[:, :3, :3], -1, -2))
    jacobian[:, 3:] *= _LEVER_M
    return error, jacobian


def _step(
    at_ends: tuple[np.ndarray, np.ndarray], error: np.ndarray, jacobian: np.ndarray, damping: np.ndarray
) -> np.ndarray:
    """(m, n) the step, without the joints that would leave their range; at_ends (m, n): who is at its lower, upper."""
    step = _least_squares(jacobian, error, damping)
    stuck = (at_ends[0] & (step < 0.0)) | (at_ends[1] & (step > 0.0))
    if stuck.any():
        step = _least_squares(np.where(stuck[:, None, :], 0.0, jacobian), error, damping)
    longest = np.abs(step).max(axis=1, keepdims=True)
    return step * np.minimum(1.0, _STEP_RAD / np.maximum(longest, _FLOOR))


def _least_squares(jacobian: np.ndarray, error: np.ndarray, damping: np.ndarray) -> np.ndarray:
    transposed = np.swapaxes(jacobian, -1, -2)
    hessian = transposed @ jacobian + (damping + _FLOOR)[:, None, None] * np.eye(jacobian.shape[-1])
    return np.linalg.solve(hessian, (transposed @ error[..., None]))[..., 0]


def _squares(rows: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", rows, rows)
