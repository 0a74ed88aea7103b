"""Carry one prop from place A to B and back, endlessly, with a handover at M in the middle.

Each carry starts from the current state: an arm that reaches the prop carries it one step towards its goal. Missed
grasps, slips and displaced props therefore need no special case. The prop is put down at a random position and yaw, so
that no two carries are alike. The other arm keeps moving while fingers close and open.
"""

import logging

import numpy as np

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.operator.hands import Hands, Pose, pause
from lerobot_robot_yam.rig.operator.script import PUT_DOWN_M, Script, Setup, lifted
from lerobot_robot_yam.rig.operator.worker import Worker

logger = logging.getLogger(__name__)

_GRIP_M = np.array([0.0, 0.0, 0.005])  # grasp offset from the prop's centre: tips of a tilted tool reach deeper
_BESIDE_M = 0.07  # distance to a place below which a prop counts as being there
_ABOUT_M = np.array([0.045, 0.035, 0.0])  # maximum random offset of the prop from its place
_QUARTER_RAD = np.pi / 4  # maximum random turn; covers all orientations of a cube
_WAIT_M = np.array([0.05, 0.08, 0.07])  # free arm's maximum offset from home: in x both ways, in y outward, in z up
_WAIT_RAD = 0.5  # maximum turn of a waiting tool
_STROLL_S = 1.1  # minimum duration of a free arm's move to another waiting position
_AHEAD_S = 0.25  # the free arm starts this long before the other arm arrives and closes or opens its fingers
_GIVE_UP = 5  # consecutive failures after which the prop is put back
_PAST_MIDDLE_M = 0.10  # how far beyond the middle an arm may fetch a prop that it carries to its own end


class PickAndPlace(Script):
    """Script for two arms; each `work` carries the scene's first prop one step towards its goal."""

    endless = True

    def __init__(self, hands: Hands, setup: Setup):
        super().__init__(hands, setup)
        self._prop = next(iter(setup.things.values()))  # props come before furniture
        missing = [place for place in ("A", "M", "B") if place not in setup.places_m]
        if missing or len(self.workers) < 2 or self._prop.fixed or self._prop.size_m is None:
            raise ConfigError(
                f"task {setup.task.name}: needs two arms, a prop with a size_m, and the places A, M and B; "
                f"missing places: {missing}, arms: {list(self.workers)}, first thing: {self._prop.name}"
            )
        self._half_m = float(self._prop.size_m[2]) / 2
        self._goal = "B"
        self._failures = 0
        self._random = np.random.default_rng(setup.seed)

    def work(self) -> bool:
        """Carry the prop one step towards its goal; return True if the prop arrived."""
        prop = self.look_at(self._prop.name)
        if self._is_at(prop, self._goal):
            self._goal = "A" if self._goal == "B" else "B"
        side, place = self._choose(prop)
        if side is None or self._failures >= _GIVE_UP:
            logger.warning("the prop at %s cannot be taken; putting it back", np.round(prop.position_m, 3))
            self._failures = 0
            pause(self.hands, 1.0)
            self.hands.put_back(np.array([*self.setup.places_m["A"][:2], self._half_m]))
            pause(self.hands, 0.5)
            return False
        worker = self.workers[side]
        (free,) = [other for other in self.workers.values() if other is not worker]
        try:
            done = self._carry(worker, free, prop, place)
        except RigError as error:  # out of reach: restart from the waiting pose
            logger.warning("%s", error)
            if worker.holds:
                worker.open()
            done = False
        self._failures = 0 if done else self._failures + 1
        worker.go_home()
        return done

    def _choose(self, prop: Pose) -> tuple[str | None, str]:
        """Return side and place: the goal's own arm carries to the goal, the other arm only to the middle."""
        finisher, helper = ("right", "left") if self._goal == "B" else ("left", "right")
        if prop.position_m[2] > -self._half_m:
            towards = prop.position_m[1] if finisher == "left" else -prop.position_m[1]
            for side, place in ((finisher, self._goal), (helper, "M")):
                if (side == helper or towards > -_PAST_MIDDLE_M) and self._can_take(side, prop):
                    if not self._is_at(prop, place):
                        return side, place
        return None, ""

    def _can_take(self, side: str, prop: Pose) -> bool:
        planner = self.workers[side].planner
        point = prop.position_m
        yaw = planner.grasp_yaw(point, prop.edge_yaw_rad)
        return planner.reaches(point, yaw) and planner.reaches(np.array([*point[:2], self.height_m]), yaw)

    def _is_at(self, prop: Pose, place: str) -> bool:
        return bool(np.linalg.norm((prop.position_m - self.setup.places_m[place])[:2]) < _BESIDE_M)

    def _carry(self, worker: Worker, free: Worker, prop: Pose, place: str) -> bool:
        point, planner = prop.position_m + _GRIP_M, worker.planner
        self._stroll(free, worker)
        worker.set_off(point, planner.grasp_yaw(point, prop.edge_yaw_rad))
        self._stroll(free, worker)
        worker.arrive()
        worker.close()
        height = prop.position_m[2]
        target = np.array([*self.setup.places_m[place][:2], height + PUT_DOWN_M])
        target += _GRIP_M + self._random.uniform(-1.0, 1.0, 3) * _ABOUT_M
        worker.set_off(target, planner.grasp_yaw(target, self._random.uniform(-1.0, 1.0) * _QUARTER_RAD))
        if not worker.holds_on(lifted(self._prop.name, height)):
            return False
        self._stroll(free, worker)
        worker.arrive()
        worker.open()
        return self._is_at(self.look_at(self._prop.name), place)

    def _stroll(self, free: Worker, worker: Worker) -> None:
        """Start moving the free arm to another waiting position when the other arm is about to arrive."""
        worker.wait(_AHEAD_S)
        if not free.moves:
            home = self.setup.homes_m[free.side]
            away = self._random.uniform([-1.0, 0.0, 0.0], 1.0) * _WAIT_M * [1.0, np.sign(home[1]), 1.0]
            turn = self._random.uniform(-1.0, 1.0) * _WAIT_RAD
            free.stroll(home + away, free.planner.natural_yaw(home + away) + turn, _STROLL_S)
