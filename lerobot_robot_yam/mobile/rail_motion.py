"""Plan of the rail, one axis in the motor's coordinates: speed, acceleration and ends are kept whatever is asked."""

import math

import ruckig


class RailMotion:
    """Plan of the rail's motor.

    Attributes:
        position, velocity: planned, rad, rad/s.
    """

    def __init__(self) -> None:
        self.position = self.velocity = 0.0

    def restart(self, position: float, velocity: float = 0.0) -> None:
        """Continue the plan from a measured state, rad, rad/s."""
        self.position, self.velocity = position, velocity

    def brake(self, deceleration: float, dt: float) -> None:
        """Plan `dt` seconds of braking, rad/s²."""
        before = self.velocity
        self.velocity = math.copysign(max(abs(before) - deceleration * dt, 0.0), before)
        self.position += 0.5 * (before + self.velocity) * dt

    def run(self, velocity: float, ends: tuple[float, float], acceleration: float, dt: float) -> None:
        """Plan `dt` seconds at a velocity, rad/s, that end by braking at the lower or upper end, rad.

        Reaching an end is planned as a position, so no velocity needs an end of its own braking.
        """
        end = ends[velocity > 0.0]
        if velocity == 0.0 or (end - self.position) * velocity <= 0.0:
            self.brake(acceleration, dt)
        else:
            self.reach(end, abs(velocity), acceleration, dt)

    def reach(self, position: float, speed: float, acceleration: float, dt: float) -> None:
        """Plan `dt` seconds towards a position, rad, at most at `speed`, rad/s."""
        given = ruckig.InputParameter(1)
        given.current_position, given.current_velocity = [self.position], [self.velocity]
        given.target_position = [position]
        given.max_velocity, given.max_acceleration, given.max_jerk = [speed], [acceleration], [math.inf]
        trajectory = ruckig.Trajectory(1)
        try:
            ruckig.Ruckig(1).calculate(given, trajectory)
        except ruckig.RuckigError:  # the way left is what braking takes: its solver finds no root there
            if self.velocity == 0.0:
                raise
            self.brake(acceleration, dt)
            return
        (self.position,), (self.velocity,), _ = trajectory.at_time(dt)
