"""Forward and inverse kinematics of one arm.

    arm = YamKinematics("yam", "linear_4310")
    pose = arm.fk(q)                     # (4, 4) of tcp_site in the frame of the arm's base
    result = arm.ik(pose)                # from any start: many descents, within 100 ms
    result = arm.ik(pose, near=q, attempts=1)   # in a control loop: one descent (better still: `PoseTracker`)

A pose out of reach is not an error: the result is the nearest pose found, with its remaining error.
"""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from lerobot_robot_yam.arm.ik_solver import LEVER_M, Descent, SelfClearance, Starts
from lerobot_robot_yam.arm.model import build_spec
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.arm.validation import finite_vector
from lerobot_robot_yam.errors import ActionError, ConfigError

POSITION_TOLERANCE_M, ORIENTATION_TOLERANCE_RAD = 1e-4, 1e-3

_FARTHEST_M = 10.0  # limit of a target's coordinates, m: no arm reaches 1 m, and squares must not overflow
_SKEW = 1e-3  # tolerance of RᵀR = 1, for single precision and text rounded to few digits
_UNIT = np.eye(4)
_TURN_M_PER_RAD = 0.01  # cost of joint motion in the choice among inexact solutions, m of error per radian
_ELSEWHERE_M = 0.01  # cost of an inexact solution from another start than `near`, m


@dataclass(frozen=True)
class IkResult:
    """Result of inverse kinematics.

    Attributes:
        q: (n,) rad, within the joint limits.
        converged: whether q is within 1e-4 m and 1e-3 rad of the target, and `clear` is true.
        clear: whether the arm's links keep their minimum distances; True if these were not checked.
        position_error_m, orientation_error_rad: remaining errors.
        attempts: number of descents.
    """

    q: np.ndarray
    converged: bool
    clear: bool
    position_error_m: float
    orientation_error_rad: float
    attempts: int

    @property
    def error_m(self) -> float:
        """Position and orientation error as one number, m; an error of 1 rad counts as `LEVER_M` metres."""
        return math.hypot(self.position_error_m, self.orientation_error_rad * LEVER_M)


class YamKinematics:
    """Kinematics of an arm with its end effector. Poses are (4, 4) homogeneous, m, in the frame of the arm's base.

    Not thread-safe: each thread needs its own object.

    Args:
        arm, gripper: profiles or their names.
        site: frame to be positioned: the end effector's "tcp_site" or "grasp_site" (if it has one), or an arm link.
        collision_margin_m: minimum distance between the arm's links in solutions (less for links that are nearer
            by construction), with the gripper open; None: not checked, which is many times faster.

    Attributes:
        lower, upper: (n,) joint limits, rad.
        middle: (n,) middle of the joint ranges, rad.

    Raises:
        ConfigError: there is no such arm, gripper or site, or the arm has no joints.
    """

    def __init__(
        self,
        arm: str | Path | ArmProfile,
        gripper: str | Path | GripperProfile,
        site: str = "tcp_site",
        *,
        collision_margin_m: float | None = None,
    ):
        arm, gripper = resolve_profiles(arm, gripper)
        model = build_spec(arm, gripper, visuals=False).compile()
        keeps = collision_margin_m is not None and arm.joint_count
        clearance = SelfClearance(arm, gripper, collision_margin_m or 0.0) if keeps else None
        self._set_up(model, arm.joint_count, site, clearance)

    @classmethod
    def of_model(cls, model: mujoco.MjModel, site: str = "tcp_site") -> "YamKinematics":
        """Create the kinematics of a model from `model.build_model`: base at the origin, first hinges are the arm's.

        Raises:
            ConfigError: there is no such site, or the model has no arm.
        """
        self = cls.__new__(cls)
        hinges = [kind == mujoco.mjtJoint.mjJNT_HINGE for kind in model.jnt_type]
        self._set_up(model, (*hinges, False).index(False), site, None)
        return self

    def _set_up(self, model: mujoco.MjModel, joints: int, site: str, clearance: SelfClearance | None) -> None:
        self._joints = joints
        names = [model.joint(i).name for i in range(joints)]
        if not joints or names != [f"joint{i + 1}" for i in range(joints)]:
            raise ConfigError(f"kinematics need an arm with the hinges joint1, joint2 … first, this model has {names}")
        sites = [model.site(i).name for i in range(model.nsite)]
        if site not in sites and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, site) < 0:
            raise ConfigError(f"this end effector has no site '{site}'; it has {sites}")
        self._model, self._data = model, mujoco.MjData(model)
        kind, frame = ("site", self._data.site(site)) if site in sites else ("body", self._data.body(site))
        self._position, self._rotation = frame.xpos, frame.xmat.reshape(3, 3)  # views, updated with the data
        self._body = int(model.site_bodyid[frame.id]) if kind == "site" else frame.id
        self._descent, self._clearance = Descent(model, joints, (site, kind), clearance), clearance
        self.lower, self.upper = model.jnt_range[:joints].T.copy()
        self.middle = (self.lower + self.upper) / 2
        self._starts = Starts(self._pose, self.lower, self.upper)

    def fk(self, q: np.ndarray) -> np.ndarray:
        """Compute the site's pose (4, 4) at joints `q` (n,) rad, which may be outside the limits.

        Raises:
            ActionError: `q` has a wrong shape, or is not finite.
        """
        return self._pose(finite_vector("kinematics", "q", q, self._joints))

    def poses(self, q: np.ndarray) -> np.ndarray:
        """Compute the site's poses (…, 4, 4) at joints (…, n) rad, without checks."""
        rows = np.reshape(np.asarray(q, dtype=float), (-1, self._joints))
        return np.array([self._pose(row) for row in rows]).reshape(*np.shape(q)[:-1], 4, 4)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Compute the site's Jacobian (6, n) in the axes of the base: m/s per rad/s, then rad/s per rad/s."""
        self._pose(q)
        mujoco.mj_comPos(self._model, self._data)
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian[:3], jacobian[3:], self._position, self._body)
        return jacobian[:, : self._joints]

    def descend(self, target: np.ndarray, start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> IkResult:
        """Run one descent to the pose `target` (4, 4) from joints `start` (n,) rad, between bounds (n,) rad.

        The bounds may be wider than the arm's limits, so that an arm slightly outside its limits can return.

        Raises:
            ActionError: `target` is not a pose.
        """
        pose, begin = _rigid(target), np.clip(start, lower, upper)
        self._descent.aim(pose)
        return self._judge(self._descent.run(begin, lower, upper, begin, math.inf), pose, 1)

    def ik(
        self,
        target: np.ndarray,
        near: np.ndarray | None = None,
        *,
        attempts: int = 64,
        budget_s: float = 0.1,
        within_rad: float | None = None,
    ) -> IkResult:
        """Find joints that bring the site to a pose, or as near to the pose as possible.

        Args:
            target: pose (4, 4) of the site.
            near: (n,) rad, start of the first descent, clamped to the limits; None: a stored vector with a pose similar
                to the target. The first solution found is returned, which is usually the one near the start.
            attempts: maximum number of descents; all after the first start at stored vectors with similar poses.
            budget_s: time limit for the second and later descents; the first takes at most 2 ms.
            within_rad: maximum deviation of each joint from `near`, rad; None: no limit besides the joint limits.

        Returns:
            The first solution, or the best attempt: the one with the least error plus, with `near`, 1 cm per radian of
            motion and 1 cm for another start. Attempts whose links keep their distances take precedence.

        Raises:
            ActionError: a shape is wrong, a number is not finite, or the target has no valid rotation.
        """
        deadline_s = time.monotonic() + budget_s
        pose = _rigid(target)
        lower, upper, start = self.lower, self.upper, None
        if near is not None:
            start = np.clip(finite_vector("kinematics", "near", near, self._joints), lower, upper)
            if within_rad is not None:
                lower, upper = np.maximum(lower, start - within_rad), np.minimum(upper, start + within_rad)
        self._descent.aim(pose)
        best: IkResult | None = None
        best_price = math.inf
        for number, begin in enumerate(self._begins(pose, start, attempts), 1):
            if best is not None and time.monotonic() > deadline_s:
                break
            posture = self.middle if start is None or number > 1 else start
            until_s = math.inf if number == 1 else deadline_s
            q = self._descent.run(np.clip(begin, lower, upper), lower, upper, posture, until_s)
            result = self._judge(q, pose, number)
            if result.converged:
                return result
            away = 0.0 if start is None else float(np.abs(q - start).max())
            elsewhere = 0.0 if start is None or number == 1 else _ELSEWHERE_M
            price = result.error_m + _TURN_M_PER_RAD * away + elsewhere + (0.0 if result.clear else _FARTHEST_M)
            if best is None or price < best_price:
                best, best_price = result, price
        if best is None:
            raise ActionError(f"kinematics: at least one attempt is needed, not {attempts}")
        return best

    def _begins(self, pose: np.ndarray, start: np.ndarray | None, attempts: int) -> Iterator[np.ndarray]:
        """Yield the starts of the descents, the most promising first."""
        if start is not None and attempts > 0:
            attempts -= 1
            yield start
        if attempts > 0:
            yield from self._starts.nearest(pose, attempts, start)

    def _judge(self, q: np.ndarray, target: np.ndarray, attempts: int) -> IkResult:
        position, orientation = pose_errors(self._pose(q), target)
        near = position <= POSITION_TOLERANCE_M and orientation <= ORIENTATION_TOLERANCE_RAD
        clear = self._clearance is None or self._clearance.kept(q)
        return IkResult(q, near and clear, clear, position, orientation, attempts)

    def _pose(self, q: np.ndarray) -> np.ndarray:
        self._data.qpos[: self._joints] = q
        mujoco.mj_kinematics(self._model, self._data)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self._rotation, self._position
        return pose


class PoseTracker:
    """Tracker of a target pose: each solve starts at the extrapolation of the two previous solutions.

    At a singularity, such as the stretched elbow, two branches of solutions meet, and the pose alone cannot distinguish
    them, but the motion can: the solution is sought near q + Δq, with Δq the last step. Without the extrapolation, one
    random joint path in ten ends on the wrong branch, half of these at a joint limit.

    Args:
        kinematics: kinematics of the arm; no other thread may use this object.
        q: (n,) rad, current joints.

    Attributes:
        q: (n,) rad, the newest solution, or the start.
    """

    def __init__(self, kinematics: YamKinematics, q: np.ndarray):
        self._kinematics = kinematics
        self.restart(q)

    def restart(self, q: np.ndarray) -> None:
        """Restart at `q` (n,) rad, at rest."""
        self.q: np.ndarray = np.array(q, dtype=float)
        self._step, self._moving = np.zeros(len(q)), False

    def solve(self, target: np.ndarray, *, attempts: int = 1, within_rad: float | None = None) -> IkResult:
        """Solve for the next pose (4, 4); arguments as for `YamKinematics.ik`. The result does not depend on the clock.

        Raises:
            ActionError: `target` is not a pose; nothing has changed.
        """
        start = self.q + self._step
        result = self._kinematics.ik(target, start, attempts=attempts, budget_s=math.inf, within_rad=within_rad)
        # Only moves between converged first attempts are steps of the path, unlike the move to the first pose.
        on_path = result.converged and result.attempts == 1
        self._step = result.q - self.q if self._moving and on_path else np.zeros_like(result.q)
        self.q, self._moving = result.q, on_path
        return result


def pose_errors(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Compute the distance between two poses (4, 4) as (position, m; angle, rad).

    The angle φ is computed from |R₁ − R₂|² = 8 sin²(φ/2), which is accurate for small angles, too.
    """
    chord = float(np.linalg.norm(first[:3, :3] - second[:3, :3])) / math.sqrt(8.0)
    return float(np.linalg.norm(first[:3, 3] - second[:3, 3])), 2.0 * math.asin(min(chord, 1.0))


def pose_distance_m(first: np.ndarray, second: np.ndarray) -> float:
    """Return the distance between two poses (4, 4) as one number, m; a rotation of 1 rad counts as `LEVER_M` metres."""
    position, angle = pose_errors(first, second)
    return math.hypot(position, angle * LEVER_M)


def _rigid(target: np.ndarray) -> np.ndarray:
    """Copy `target` as a (4, 4) pose with orthonormal rotation. Raises ActionError: `target` is not a pose."""
    given = np.asarray(target)
    if given.shape != (4, 4):
        raise ActionError(f"kinematics: a target pose must have shape (4, 4), not {given.shape}")
    pose = finite_vector("kinematics", "target pose", given.ravel(), 16).reshape(4, 4)
    rotation = pose[:3, :3]
    gram = rotation.T @ rotation
    off = max(np.abs(gram - _UNIT[:3, :3]).max(), np.abs(pose[3] - _UNIT[3]).max())
    if not off < _SKEW or _determinant(rotation) < 0.0:
        raise ActionError(
            "kinematics: a target pose must be a rotation and a translation in metres, the last row 0 0 0 1; "
            f"this one is\n{pose}"
        )
    pose[:3, :3] = rotation @ (1.5 * _UNIT[:3, :3] - 0.5 * gram)  # Newton step to the nearest rotation
    pose[:3, 3] = np.minimum(np.maximum(pose[:3, 3], -_FARTHEST_M), _FARTHEST_M)
    pose[3] = _UNIT[3]
    return pose


def _determinant(m: np.ndarray) -> float:
    (a, b, c), (d, e, f), (g, h, i) = m.tolist()
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
