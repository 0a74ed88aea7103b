"""Motion of the base: from a target, through limits and ruckig's plan of each axis, to rates of the casters.

The plan lives in the world frame, as in the vendor's driver: a target in the body's frame is rotated, then limited. The
plan's velocity changes by the limits of acceleration only, whatever the target does. Position targets are planned anew
at each tick from the odometry's pose, so that wheels that lag behind the plan leave no error.
"""

import math

import numpy as np
import ruckig

from lerobot_robot_yam.mobile.base_limits import BaseLimits
from lerobot_robot_yam.mobile.base_profile import HARD_CAP, HARD_CAP_ACCELERATION, BaseProfile
from lerobot_robot_yam.mobile.base_target import Frame, Target
from lerobot_robot_yam.mobile.casters import Casters, wrapped
from lerobot_robot_yam.mobile.odometry import Odometry, to_body, to_world

_THERE = np.array([0.001, 0.001, 0.003])  # distance from a pose target, m, m, rad, within which the base stays
_NO_JERK = math.inf


_HARD = BaseLimits(HARD_CAP, HARD_CAP_ACCELERATION)


class BaseMotion:
    """Plan and odometry of one base.

    Attributes:
        odometry: pose and velocity from the wheels.
        velocity: (3,) planned velocity in the world frame.
        slowed: factor by which the last tick's target was slowed down, 0 … 1.
    """

    def __init__(self, profile: BaseProfile, limits: BaseLimits):
        self._casters, self._limits, self._usual = Casters(profile), limits, limits
        self.odometry = Odometry()
        self.velocity = np.zeros(3)
        self._acceleration = np.zeros(3)
        self.slowed = 1.0
        self._planner, self._trajectory, self._given = ruckig.Ruckig(3), ruckig.Trajectory(3), ruckig.InputParameter(3)
        self._given.synchronization = ruckig.Synchronization.No

    def measure(self, steer: np.ndarray, rates: np.ndarray, dt: float) -> None:
        """Integrate measured rates (8,), rad/s, at steering angles (4,), rad, over the measured time `dt`, s."""
        self.odometry.step(self._casters.twist(steer, rates), dt)

    def reset_odometry(self) -> None:
        """Make the present pose the origin of the odometry; the base drives on."""
        self.velocity = to_body(self.velocity, float(self.odometry.pose[2]))
        self._acceleration = to_body(self._acceleration, float(self.odometry.pose[2]))
        self.odometry.reset()

    def restart(self) -> None:
        """Continue the plan from the measured velocity, as after a pause in which nothing was commanded."""
        self.velocity, self._acceleration = self.odometry.twist.copy(), np.zeros(3)

    def advance(
        self, target: Target, steer: np.ndarray, dt: float, most_speed: float = 1.0, hard: bool = False
    ) -> np.ndarray:
        """Plan one tick of `dt` seconds, and return the rates (8,), rad/s, to command.

        Args:
            target: where to go, or how fast.
            steer: (4,) measured steering angles, rad.
            most_speed: share of the velocity limits that is allowed now, 0 … 1.
            hard: whether to brake with the hard cap of acceleration and without a limit of jerk.
        """
        self._limits = _HARD if hard else self._usual
        heading = float(self.odometry.pose[2])
        if target.pose:
            self._approach(target.values, steer, heading, dt, most_speed)
        else:
            self._reach_velocity(target, steer, heading, dt, most_speed)
        return self._casters.rates(steer, to_body(self.velocity, heading))

    def _reach_velocity(self, target: Target, steer: np.ndarray, heading: float, dt: float, most_speed: float) -> None:
        twist = target.values if target.frame is Frame.LOCAL else to_body(target.values, heading)
        twist = self._within(twist) * most_speed
        self.slowed = self._casters.slow_down(steer, twist)
        given = self._input(ruckig.ControlInterface.Velocity)
        given.target_velocity = self._clipped(to_world(twist * self.slowed, heading), most_speed)
        self._follow(given, dt)

    def _approach(self, pose: np.ndarray, steer: np.ndarray, heading: float, dt: float, most_speed: float) -> None:
        away = pose - self.odometry.pose
        away[2] = wrapped(float(away[2]))
        away = np.where(np.abs(away) < _THERE, 0.0, away)
        fastest = np.sign(away) * self._limits.velocity * most_speed
        self.slowed = self._casters.slow_down(steer, to_body(fastest, heading))
        given = self._input(ruckig.ControlInterface.Position)
        given.target_position, given.target_velocity = away.tolist(), (0.0, 0.0, 0.0)
        given.max_velocity = np.maximum(np.array(self._limits.velocity) * most_speed * self.slowed, 1e-3)
        try:
            self._follow(given, dt)
        except ruckig.RuckigError:  # the way left is what braking takes: its solver finds no root there
            if not self.velocity.any():
                raise
            given = self._input(ruckig.ControlInterface.Velocity)
            given.target_velocity = (0.0, 0.0, 0.0)
            self._follow(given, dt)

    def _within(self, twist: np.ndarray) -> np.ndarray:
        """Limit a body twist without changing its direction: by speed, and by the acceleration of a curve."""
        x, y, spin = twist.tolist()
        most = self._limits.velocity
        share = max(abs(x) / most[0], abs(y) / most[1], abs(spin) / most[2], 1.0)
        sideways = abs(spin) * math.hypot(x, y) / share**2  # m/s², towards the middle of the curve
        most_sideways = min(self._limits.acceleration[:2])
        return twist / share if sideways <= most_sideways else twist / share * math.sqrt(most_sideways / sideways)

    def _clipped(self, velocity: np.ndarray, most_speed: float) -> list[float]:
        most = [limit * most_speed for limit in self._limits.velocity]
        return [min(max(asked, -limit), limit) for asked, limit in zip(velocity.tolist(), most, strict=True)]

    def _input(self, interface: ruckig.ControlInterface) -> ruckig.InputParameter:
        given = self._given
        given.control_interface = interface
        given.current_velocity, given.current_acceleration = self.velocity.tolist(), self._acceleration.tolist()
        given.max_velocity, given.max_acceleration = self._limits.velocity, self._limits.acceleration
        given.max_jerk = self._limits.jerk or (_NO_JERK,) * 3
        return given

    def _follow(self, given: ruckig.InputParameter, dt: float) -> None:
        """Take the plan's velocity after `dt` seconds."""
        self._planner.calculate(given, self._trajectory)
        _, velocity, acceleration = self._trajectory.at_time(dt)
        self.velocity = np.array(velocity)
        self._acceleration = np.array(acceleration) if self._limits.jerk else np.zeros(3)
