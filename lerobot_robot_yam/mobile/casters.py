"""Kinematics of powered casters: twist to steering and drive rates, and back by least squares.

Equations of the vendor's driver v1.2.4, after Holmberg and Khatib, "Development and control of a holonomic mobile robot
for mobile manipulation tasks", 2000. With s, c of a steering angle, caster position h, contact offset b and wheel
radius r, each caster has two rows of rates = C @ twist:

    steer   s/bx                −c/bx               (−hx c − hy s)/bx − 1
    drive   c/r − by s/(bx r)   s/r + by c/(bx r)   (hx s − hy c)/r + by (hx c + hy s)/(bx r)
"""

import math

import numpy as np

from lerobot_robot_yam.mobile.base_profile import FLIP_RAD_S, BaseProfile


class Casters:
    """Casters of one base. Rates are (8,), rad/s: steering and drive of each caster in turn, in joint coordinates."""

    def __init__(self, profile: BaseProfile):
        self._hx, self._hy = np.array(profile.h_x_m), np.array(profile.h_y_m)
        self._bx, self._by, self._r = profile.b_x_m, profile.b_y_m, profile.radius_m

    def rates(self, steer: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Return the rates (8,) that give a body twist (3,), m/s, m/s, rad/s, at steering angles (4,), rad."""
        return self.twist_to_rates(steer) @ twist

    def twist(self, steer: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the body twist (3,) that fits measured rates (8,) best, at steering angles (4,), rad."""
        return self.rates_to_twist(steer) @ rates

    def twist_to_rates(self, steer: np.ndarray) -> np.ndarray:
        """Return the matrix C (8, 3) of the equations above."""
        s, c = np.sin(steer), np.cos(steer)
        hx, hy, bx, by, r = self._hx, self._hy, self._bx, self._by, self._r
        matrix = np.empty((8, 3))
        along, across = hx * c + hy * s, hx * s - hy * c
        matrix[0::2] = np.column_stack((s / bx, -c / bx, -along / bx - 1.0))
        matrix[1::2] = np.column_stack(
            (c / r - by * s / (bx * r), s / r + by * c / (bx * r), across / r + by * along / (bx * r))
        )
        return matrix

    def rates_to_twist(self, steer: np.ndarray) -> np.ndarray:
        """Return the matrix X (3, 8) that solves (PᵀP) X = N; X C is the identity.

        P maps the twist to the velocities of the contact points, N maps the rates to their sum.
        """
        s, c = np.sin(steer), np.cos(steer)
        hx, hy, bx, by, r = self._hx, self._hy, self._bx, self._by, self._r
        along, across = hx * c + hy * s, hx * s - hy * c
        contact_x, contact_y = bx * c - by * s + hx, -bx * s - by * c - hy
        square = np.array(
            [
                [4.0, 0.0, contact_y.sum()],
                [0.0, 4.0, contact_x.sum()],
                [contact_y.sum(), contact_x.sum(), (contact_x**2 + contact_y**2).sum()],
            ]
        )
        sums = np.empty((3, 8))
        sums[:, 0::2] = bx * s + by * c, -bx * c + by * s, bx * (-along - bx) + by * (across - by)
        sums[:, 1::2] = r * c, r * s, r * (across - by)
        return np.linalg.solve(square, sums)

    def slow_down(self, steer: np.ndarray, twist: np.ndarray, most_rad_s: float = FLIP_RAD_S) -> float:
        """Return the factor, 0 … 1, that keeps every steering rate within `most_rad_s` until the casters trail.

        A steering axis that moves at v turns its caster at v/|bx| sin δ, where δ is the angle by which the caster does
        not yet trail; the body's own rotation is subtracted. Until the caster trails, sin δ passes through its maximum
        if δ is more than 90°. The rate is proportional to the twist, so the twist has to become smaller by a factor.
        """
        vx, vy = twist[0] - twist[2] * self._hy, twist[1] + twist[2] * self._hx
        s, c = np.sin(steer), np.cos(steer)
        ahead, beside = c * vx + s * vy, c * vy - s * vx  # velocity of the axis in the caster's frame
        peak = np.where(ahead < 0.0, np.copysign(np.hypot(ahead, beside), beside), beside) / abs(self._bx) - twist[2]
        worst = max(float(np.abs(peak).max()), abs(float(twist[2])))
        return 1.0 if worst <= most_rad_s else most_rad_s / worst


def wrapped(angle_rad: float) -> float:
    """Return an angle within −π … π, rad."""
    return math.remainder(angle_rad, math.tau)
