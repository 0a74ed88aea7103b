"""Kinematics of powered casters: twist to steering and drive rates, and back by least squares.

Equations of the vendor's driver v1.2.4, after Holmberg and Khatib, "Development and control of a holonomic mobile robot
for mobile manipulation tasks", 2000. With s, c of a steering angle, caster position h, contact offset b and wheel
radius r, each caster has two rows of rates = C @ twist:

    steer   s/bx                −c/bx               (−hx c − hy s)/bx − 1
    drive   c/r − by s/(bx r)   s/r + by c/(bx r)   (hx s − hy c)/r + by (hx c + hy s)/(bx r)

The code is in plain numbers: for four casters that takes a quarter of the time of the same in numpy, or less.
"""

import math
from collections.abc import Iterator

import numpy as np

from lerobot_robot_yam.mobile.base_profile import FLIP_RAD_S, BaseProfile


class Casters:
    """Casters of one base. Rates are (8,), rad/s: steering and drive of each caster in turn, in joint coordinates."""

    def __init__(self, profile: BaseProfile):
        self._hx, self._hy = profile.h_x_m, profile.h_y_m
        self._bx, self._by, self._r = profile.b_x_m, profile.b_y_m, profile.radius_m

    def rates(self, steer: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Return the rates (8,) that give a body twist (3,), m/s, m/s, rad/s, at steering angles (4,), rad."""
        slant, spin = self._by / self._bx, float(twist[2])
        axes = self._axes(steer, twist)
        rates = [(-beside / self._bx - spin, (ahead + slant * beside) / self._r) for ahead, beside in axes]
        return np.array(rates).ravel()

    def _axes(self, steer: np.ndarray, twist: np.ndarray) -> Iterator[tuple[float, float]]:
        """Yield the velocity, m/s, of each steering axis, ahead and to the left in the frame of its caster."""
        x, y, spin = twist.tolist()
        for angle, hx, hy in zip(steer.tolist(), self._hx, self._hy, strict=True):
            s, c = math.sin(angle), math.cos(angle)
            vx, vy = x - spin * hy, y + spin * hx
            yield c * vx + s * vy, c * vy - s * vx

    def twist(self, steer: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the body twist (3,) that fits measured rates (8,) best, at steering angles (4,), rad.

        The velocities of the contact points are P @ twist, and they follow from the rates; this solves PᵀP twist = Pᵀv.
        """
        bx, by, r = self._bx, self._by, self._r
        vx = vy = turn = across = along = square = 0.0
        flat = rates.tolist()
        for angle, hx, hy, steered, driven in zip(
            steer.tolist(), self._hx, self._hy, flat[0::2], flat[1::2], strict=True
        ):
            s, c = math.sin(angle), math.cos(angle)
            px, py = hx + bx * c - by * s, hy + bx * s + by * c  # contact point in the frame of the body
            x = r * driven * c + steered * (bx * s + by * c)
            y = r * driven * s - steered * (bx * c - by * s)
            vx, vy, turn = vx + x, vy + y, turn + px * y - py * x
            along, across, square = along + px, across + py, square + px * px + py * py
        n = len(self._hx)
        spin = (turn - (along * vy - across * vx) / n) / (square - (along * along + across * across) / n)
        return np.array([(vx + across * spin) / n, (vy - along * spin) / n, spin])

    def slow_down(self, steer: np.ndarray, twist: np.ndarray, most_rad_s: float = FLIP_RAD_S) -> float:
        """Return the factor, 0 … 1, that keeps every steering rate within `most_rad_s` until the casters trail.

        A steering axis that moves at v turns its caster at v/|bx| sin δ, where δ is the angle by which the caster does
        not yet trail; the body's own rotation is subtracted. Until the caster trails, sin δ passes through its maximum
        if δ is more than 90°. The rate is proportional to the twist, so the twist has to become smaller by a factor.
        """
        spin = float(twist[2])
        worst = abs(spin)
        for ahead, beside in self._axes(steer, twist):
            peak = math.copysign(math.hypot(ahead, beside), beside) if ahead < 0.0 else beside
            worst = max(worst, abs(peak / abs(self._bx) - spin))
        return 1.0 if worst <= most_rad_s else most_rad_s / worst


def wrapped(angle_rad: float) -> float:
    """Return an angle within −π … π, rad."""
    return math.remainder(angle_rad, math.tau)
