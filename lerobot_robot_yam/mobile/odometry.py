"""Odometry of the base: integrates measured body twists with the heading at the middle of each step."""

import math

import numpy as np


class Odometry:
    """Pose of the base since `reset`, from its wheels alone; slip stays in it as drift.

    Attributes:
        pose: (3,) x, y in m, heading in rad, not wrapped, in the world frame.
        twist: (3,) velocity in the world frame, m/s, m/s, rad/s.
        body_twist: (3,) the same velocity in the body frame.
    """

    def __init__(self) -> None:
        self.pose: np.ndarray = np.zeros(3)
        self.twist: np.ndarray = np.zeros(3)
        self.body_twist: np.ndarray = np.zeros(3)

    def reset(self) -> None:
        """Set pose and velocities to zero."""
        self.pose, self.twist, self.body_twist = np.zeros(3), np.zeros(3), np.zeros(3)

    def step(self, body_twist: np.ndarray, dt: float) -> None:
        """Integrate a body twist (3,) over the measured time `dt`, s."""
        self.body_twist = body_twist
        self.twist = to_world(body_twist, float(self.pose[2]) + 0.5 * float(body_twist[2]) * dt)
        self.pose = self.pose + self.twist * dt


def to_world(twist: np.ndarray, heading: float) -> np.ndarray:
    """Rotate a twist (3,) from the body frame to the world frame. heading: rad."""
    s, c = math.sin(heading), math.cos(heading)
    return np.array([c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]])


def to_body(twist: np.ndarray, heading: float) -> np.ndarray:
    """Rotate a twist (3,) from the world frame to the body frame. heading: rad."""
    return to_world(twist, -heading)
