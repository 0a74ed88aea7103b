"""Damped least squares, the inner loop of inverse kinematics, and the choice of start vectors.

With the error twist e of the site in its own frame, and the Jacobian J of e (mink's FrameTask), each iteration solves

    min   ½ |W (J Δq − e)|²  +  ½ μ |Δq|²  +  ½ w² |q + Δq − q_posture|²
    s.t.  q_lower ≤ q + Δq ≤ q_upper,   |Δq_j| ≤ Δ_max,   d_k(q) + ∇d_k · Δq ≥ limit_k

as a box-constrained QP with DAQP, whose box constraints take a fifth of the time of `mink.solve_ik`. Levenberg's μ
decreases with the error, so that the last steps are Newton steps, and increases after a step that does not help; far
from the solution and near singularities the method becomes gradient descent. The last constraint is optional, see
`SelfClearance`.
"""

import time
from collections.abc import Callable

import daqp
import mink
import mujoco
import numpy as np

from lerobot_robot_yam.arm.collision.clearance import choose_pairs
from lerobot_robot_yam.arm.collision.parts import ArmParts, GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile

LEVER_M = 0.1
"""Position error, m, that costs as much as an orientation error of one radian."""

_ITERATIONS = 25
_STOP_M, _STOP_RAD = 1e-6, 1e-5  # errors that end a descent: a hundredth of the tolerance, for smooth paths
_STUCK = 1e-3  # minimum relative decrease of the cost per step; a smaller decrease ends the descent
_STEP_RAD = 0.7  # maximum step per joint, rad: the linearisation is poor beyond
_CAREFUL_STEP_RAD = 0.2  # maximum step per joint with a clearance, rad: distances are less linear than poses
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-6, 1e3  # initial, minimum and maximum μ
_FLOOR = 1e-12  # added to the Hessian's diagonal: QP solvers need a positive definite matrix
_POSTURE = 1e-9  # w²: posture decides only where the pose leaves freedom, at singularities; error elsewhere < 1e-8 m
_UNBOUNDED = 1e30  # bound that DAQP treats as infinite
_FOUL_M = 1e-4  # maximum decrease of a distance below its limit in one step, due to curvature, m
_NEAR_M = 0.05  # distance beyond its limit above which a pair does not constrain a step, m
_ENOUGH_M = 5e-4  # tolerance of a limited distance, m: hulls are accurate to millimetres only

_STARTS = 1000  # number of stored joint vectors
_ALIKE_M_PER_RAD = 0.3  # weight of orientation in the choice of starts; LEVER_M would favour position
_TRAVEL_M_PER_RAD = 0.05  # cost of joint motion in the choice of starts: of two similar poses the nearer comes first

_NO_SLACK = np.zeros(0)


class SelfClearance:
    """Distances between an arm's own links with the gripper open: the pairs of `choose_pairs` and their limits.

    Args:
        arm, gripper: profiles.
        margin_m: minimum distance between links; links that are closer by construction have a smaller limit.

    Raises:
        ConfigError: the margin is out of range.
    """

    def __init__(self, arm: ArmProfile, gripper: GripperProfile, margin_m: float):
        guarded = GuardedArm(arm.name, arm, gripper, WorkspaceConfig(collision_margin_m=margin_m))
        self._parts = ArmParts([guarded])
        self._pairs = choose_pairs(self._parts, [guarded])
        first, second = (np.array([pair[i] for pair in self._pairs], dtype=int) for i in (0, 1))
        self._first, self._second = first, second
        limits = np.array([pair.limit_m for pair in self._pairs])
        self._reach = self._parts.radius[first] + self._parts.radius[second] + limits + _NEAR_M

    def rows(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute gradients (k, n), m/rad, and slacks (k,), m, of pairs near their limit at `q` (n,); < 0: too near."""
        parts = self._parts
        parts.place(q)
        between = parts.centres[self._first] - parts.centres[self._second]
        near = np.flatnonzero(np.einsum("ij,ij->i", between, between) < self._reach**2)
        gradients, slack = [], []
        for pair in (self._pairs[i] for i in near.tolist()):
            distance, gradient = parts.distance_gradient(pair.first, pair.second, pair.limit_m + _NEAR_M)
            if distance < pair.limit_m + _NEAR_M:
                gradients.append(gradient)
                slack.append(distance - pair.limit_m)
        return np.array(gradients).reshape(len(slack), len(q)), np.array(slack)

    def kept(self, q: np.ndarray) -> bool:
        """Return whether every pair is at least as far apart as its limit at `q` (n,)."""
        return bool((self.rows(q)[1] > -_ENOUGH_M).all())


class Descent:
    """Iterative descent from a start vector to a pose of one frame. Not thread-safe.

    Args:
        model: model whose first joints are the arm's; its other joints stay at `qpos0`.
        joints: number of the arm's joints.
        frame: name and kind ("site" or "body") of a frame in the model.
        clearance: distances to maintain; None: no limits.
    """

    def __init__(
        self, model: mujoco.MjModel, joints: int, frame: tuple[str, str], clearance: SelfClearance | None = None
    ):
        self._configuration = mink.Configuration(model)
        self._task = mink.FrameTask(*frame, position_cost=1.0, orientation_cost=LEVER_M)
        self._clearance = clearance
        self._full = model.qpos0.copy()
        self._joints, self._no_rows = joints, np.zeros((0, joints))

    def aim(self, pose: np.ndarray) -> None:
        """Set the target pose (4, 4)."""
        self._task.set_target(mink.SE3.from_matrix(pose))

    def run(
        self, q: np.ndarray, lower: np.ndarray, upper: np.ndarray, posture: np.ndarray, deadline_s: float
    ) -> np.ndarray:
        """Descend from `q`, which is between `lower` and `upper`; return the final joints (n,).

        Args:
            posture: (n,) joints preferred where the pose leaves freedom.
            deadline_s: monotonic time at which to stop.
        """
        damping, (jacobian, error) = _DAMPING, self._residual(q)
        cost = float(error @ error)
        rows, slack = self._distances(q)
        step = _STEP_RAD if self._clearance is None else _CAREFUL_STEP_RAD
        for _ in range(_ITERATIONS):
            if _solved(error) or time.monotonic() > deadline_s:
                break
            hessian = jacobian.T @ jacobian
            hessian.flat[:: len(q) + 1] += damping * min(cost, 1.0) + _POSTURE + _FLOOR
            gradient = _POSTURE * (q - posture) - error @ jacobian
            move = _solve_qp(hessian, gradient, np.maximum(lower - q, -step), np.minimum(upper - q, step), rows, slack)
            there = np.minimum(np.maximum(q + move, lower), upper)
            there_jacobian, there_error = self._residual(there)
            there_cost = float(there_error @ there_error)
            there_rows, there_slack = self._distances(there)
            if not there_cost < cost or _worst(there_slack) < min(_worst(slack), 0.0) - _FOUL_M:
                damping = max(damping, 1e-3) * 10.0
                if damping > _MOST_DAMPING:
                    break
                continue
            gained = cost - there_cost
            q, jacobian, error, cost = there, there_jacobian, there_error, there_cost
            rows, slack = there_rows, there_slack
            damping = max(damping / 5.0, _LEAST_DAMPING)
            if gained < _STUCK * (cost + gained):
                break
        return q

    def _residual(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute W J (6, n) and W e (6,), with three rows for position and three for orientation."""
        self._full[: self._joints] = q
        self._configuration.update(self._full)
        jacobian, error, _ = self._task.compute_qp_residual(self._configuration)
        return jacobian[:, : self._joints], error

    def _distances(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute gradients (k, n) and slacks (k,) of the distances near their limits."""
        return (self._no_rows, _NO_SLACK) if self._clearance is None else self._clearance.rows(q)


class Starts:
    """Random joint vectors, uniform in the joint ranges, and their poses: starts for targets with no solution nearby.

    Starting at poses similar to the target halves the number of descents, compared with random starts.

    Args:
        fk: function from joints (n,) to the pose (4, 4).
        lower, upper: (n,) joint limits, rad.
    """

    def __init__(self, fk: Callable[[np.ndarray], np.ndarray], lower: np.ndarray, upper: np.ndarray):
        self._q = np.random.default_rng(1).uniform(lower, upper, size=(_STARTS, len(lower)))
        self._poses = np.array([fk(q) for q in self._q])

    def nearest(self, pose: np.ndarray, count: int, near: np.ndarray | None = None) -> np.ndarray:
        """Select at most `count` joint vectors (count, n) with poses most similar to `pose` (4, 4), best first.

        Rotations are compared by |R₁ − R₂|² ≈ 2 φ².
        """
        off = self._poses[:, :3] - pose[:3]
        off[:, :, :3] *= _ALIKE_M_PER_RAD / np.sqrt(2.0)
        distance = np.einsum("kij,kij->k", off, off)
        if near is not None:
            away = np.abs(self._q - near).max(axis=1)
            distance += (_TRAVEL_M_PER_RAD * away) ** 2
        count = min(count, _STARTS)
        best = np.argpartition(distance, count - 1)[:count]
        return self._q[best[np.argsort(distance[best])]]


def _solved(error: np.ndarray) -> bool:
    x, y, z, a, b, c = error.tolist()
    near = max(abs(x), abs(y), abs(z)) < _STOP_M
    return near and max(abs(a), abs(b), abs(c)) < _STOP_RAD * LEVER_M


def _worst(slack: np.ndarray) -> float:
    return float(slack.min()) if slack.size else 0.0


def _solve_qp(
    hessian: np.ndarray, gradient: np.ndarray, lower: np.ndarray, upper: np.ndarray, rows: np.ndarray, slack: np.ndarray
) -> np.ndarray:
    """Minimise ½ xᵀ H x + gᵀ x in the box, with rows · x ≥ −max(slack, 0): pairs already too near get no nearer."""
    if not slack.size:
        return daqp.solve(hessian, gradient, rows, upper, lower, np.zeros(upper.size, np.int32))[0]
    highest = np.concatenate([upper, np.full(slack.size, _UNBOUNDED)])
    lowest = np.concatenate([lower, -np.maximum(slack, 0.0)])
    return daqp.solve(hessian, gradient, rows, highest, lowest, np.zeros(highest.size, np.int32))[0]
