"""Gravity torque of an arm, as a linear function of the masses and centres of mass of its links.

Let h_i be the first moment (mass times centre of mass, kg m) of link i in the link's frame, and R_i the link's
rotation. The potential energy is −Σ gᵀ R_i h_i plus a constant, and

    ∂τ_j / ∂h_i = −gᵀ (z_j × R_i ·)        for links i that joint j moves; z_j: axis of joint j

A mass further out has the same effect as a moment of each link between base and mass. A moment along a joint's own axis
has the same effect as a moment of the preceding link. Two numbers per link, the components perpendicular to the joint's
axis, therefore describe every change of masses, centres of mass and tool load (base parameters: Gautier and Khalil,
"Direct calculation of minimum set of inertial parameters of serial robots", IEEE Trans. Robotics and Automation, 1990).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile, Load

PAYLOAD_TERMS = ("mass", "moment x", "moment y", "moment z")
LEAST_LINK_KG = 0.05  # minimum mass of a link for fitting its moments, kg: excludes a bare wrist
_SAMPLES = 200
_FELT_M_S2 = 0.05  # minimum effect of a moment for fitting it, Nm per kg m; the maximum possible effect is 9.81


class Term(NamedTuple):
    """Moment of the link that joint `joint` (from 0) moves, along `axis` (3,) in the link's frame."""

    joint: int
    axis: np.ndarray


class GravityTerms(GravityModel):
    """Derivatives of the gravity torque of an arm with n joints, with respect to moments of links.

    Attributes:
        terms: the p moments that affect the torque in this mounting, in order from the base.
    """

    def __init__(
        self,
        arm: ArmProfile,
        gripper: GripperProfile,
        *,
        load: Load | None = None,
        tilt_rad: Sequence[float] = (0.0, 0.0),
    ):
        super().__init__(arm, gripper, load=load, tilt_rad=tilt_rad)
        model, n = self.model, self.joint_count
        self._bodies = model.jnt_bodyid[:n].copy()
        weighs = [own.inertial.mass_kg >= LEAST_LINK_KG for own in arm.bodies if own.joint]
        weighs[-1] |= gripper.bodies[0].inertial.mass_kg >= LEAST_LINK_KG
        every = [Term(i, axis) for i in range(n) if weighs[i] for axis in _across(model.jnt_axis[i])]
        self._use(every)
        felt = np.abs([self.moments(q) for q in _poses(arm)]).max(axis=(0, 1))
        self._use([term for term, most in zip(every, felt, strict=True) if most > _FELT_M_S2])

    def moments(self, q: np.ndarray) -> np.ndarray:
        """Return the torques (n, p) per unit of each term at q (n,) rad, Nm per kg m."""
        self._move(q)
        turns = self._data.xmat[self._bodies[self._joints]].reshape(-1, 3, 3)
        return self._columns(np.einsum("pij,pj->pi", turns, self._axes), self._joints)

    def payload(self, q: np.ndarray) -> np.ndarray:
        """Return the torques (n, 4) at q (n,) rad of a mass at the tcp, Nm/kg, and of its moments, Nm per kg m."""
        at_tcp = self.torque_per_kg(q)
        turn = self._data.site_xmat[self._tcp].reshape(3, 3)
        last = np.full(3, self.joint_count - 1)
        return np.column_stack([at_tcp, self._columns(turn.T, last)])

    def _use(self, terms: Sequence[Term]) -> None:
        self.terms = list(terms)
        self._joints = np.array([term.joint for term in terms], dtype=int)
        self._axes = np.array([term.axis for term in terms]).reshape(-1, 3)

    def _columns(self, moments: np.ndarray, links: np.ndarray) -> np.ndarray:
        """Return the torques (n, p) of unit moments (p, 3) in world axes. `links`: (p,) link of each moment."""
        axes = self._data.xaxis[: self.joint_count]
        # −gᵀ (z × h) = z · (g × h)
        columns: np.ndarray = axes @ np.cross(self.model.opt.gravity, moments).T
        return np.where(np.arange(self.joint_count)[:, None] <= links, columns, 0.0)


def _across(axis: np.ndarray) -> list[np.ndarray]:
    """Return two directions (3,) perpendicular to an axis (3,), along axes of the link's frame where possible."""
    first = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = first - axis * (first @ axis)
    first /= np.linalg.norm(first)
    return [first, np.cross(axis, first)]


def _poses(arm: ArmProfile) -> np.ndarray:
    low, high = arm.joint_limits_rad.T
    return np.random.default_rng(0).uniform(low, high, size=(_SAMPLES, arm.joint_count))
