"""Carry a prop from one table to another with an arm on a mobile base: drive, grasp, drive, put down, drive back."""

import logging
import math

import numpy as np

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.mobile.casters import wrapped
from lerobot_robot_yam.mobile.odometry import to_body
from lerobot_robot_yam.rig.operator.hands import Hands, pause, see
from lerobot_robot_yam.rig.operator.script import PUT_DOWN_M, Script, Setup, lifted

logger = logging.getLogger(__name__)

# Of x and y together, then of the heading. All are below the limits of `BaseLimits`, which the base would keep anyway.
_SPEED = (0.35, 0.8)  # m/s, rad/s
_BRAKING = (0.15, 0.4)  # deceleration towards a stand, m/s², rad/s²; lower than the limits, since the base reacts late
_GAIN = 2.5  # of speed near a stand, 1/s
_THERE = (0.008, 0.01)  # distance from a stand that counts as arrived, m, rad
_PAST = (0.08, 0.15)  # the same for a stand that is only passed
_STEP_S = 0.05
_STOP_S = 0.4  # time to come to rest, s
_PATIENCE_S = 40.0  # maximum duration of a drive, s


class MobileTables(Script):
    """Script for arms on a base; the last stage of success names the prop and its region on the second table.

    The scene has the stands `start`, `first` (at the prop's table), `between` and `second`, and the place `put_down`,
    in the frame of the mount, of which the height is not used.
    """

    drives = True

    def __init__(self, hands: Hands, setup: Setup):
        super().__init__(hands, setup)
        missing = {"start", "first", "between", "second"} - set(setup.stands)
        if missing or "put_down" not in setup.places_m:
            raise ConfigError(f"task {setup.task.name}: needs the place put_down, and the stands {sorted(missing)}")

    def attempt(self) -> None:
        super().attempt()
        try:
            self.drive("between", "start")
        except RigError as error:  # something is in the way, or nobody reads where it wants to go
            logger.warning("%s", error)

    def work(self) -> bool:
        name = self.setup.last.prop
        self.drive("first")
        grip, prop = self.grip_of(name), self.look_at(name)
        point = prop.point(grip.point_m)
        side = self.setup.nearest(point)
        worker, home = self.workers[side], self.setup.homes_m[side]
        self.take(worker, prop, grip)
        yaw = worker.planner.natural_yaw(home)
        if not worker.carry(home, yaw, lifted(name, prop.position_m[2])):
            return False
        self.drive("between", "second")
        target = self.setup.places_m["put_down"] + (point - prop.position_m)
        target[2] += self.goal().position_m[2] + PUT_DOWN_M - self.setup.places_m["put_down"][2]
        worker.carry(target, worker.planner.natural_yaw(target), lambda sight: True)
        worker.open()
        return self.lies_at_goal()

    def drive(self, *stands: str) -> None:
        """Drive past stands and stop at the last one. Raises RigError: the base does not get there."""
        for stand in stands:
            near = _THERE if stand == stands[-1] else _PAST
            deadline = self.hands.now() + _PATIENCE_S
            while (velocity := self._towards(stand, near)).any() and self.hands.now() < deadline:
                self.hands.drive(velocity)
                self.hands.wait(_STEP_S)
            if velocity.any():
                self.hands.drive(np.zeros(3))
                raise RigError(f"the base does not get to the stand {stand}")
        self.hands.drive(np.zeros(3))
        pause(self.hands, _STOP_S)

    def _towards(self, stand: str, near: tuple[float, float]) -> np.ndarray:
        """Return the velocity (3,), in the frame of the base, with which to go on to a stand; zeros if it is near."""
        here = see(self.hands).base
        assert here is not None
        away = self.setup.stands[stand] - here
        distance, turn = math.hypot(*away[:2]), wrapped(float(away[2]))
        if distance < near[0] and abs(turn) < near[1]:
            return np.zeros(3)
        speed, rate = (
            min(_SPEED[i], _GAIN * off, math.sqrt(2.0 * _BRAKING[i] * off))
            for i, off in enumerate((distance, abs(turn)))
        )
        return to_body(np.append(away[:2] / max(distance, 1e-9) * speed, math.copysign(rate, turn)), float(here[2]))
