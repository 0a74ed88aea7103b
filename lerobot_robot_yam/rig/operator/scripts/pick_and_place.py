"""Carry one prop from place A to B and back, handing it over at M in the middle, without end.

Each carry is decided anew from what is seen: the arm that reaches the prop takes it one step towards its goal. So a
missed grasp, a slip or a displaced prop needs no special case.
"""

import logging

import numpy as np

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.operator.hands import Hands, Pose, pause
from lerobot_robot_yam.rig.operator.scripts.script import PUT_DOWN_M, Script, Setup, lifted
from lerobot_robot_yam.rig.operator.worker import Worker
from lerobot_robot_yam.rig.scene.props import Grip

logger = logging.getLogger(__name__)

_GRIP = Grip("middle", turns=4)  # of a cube, at its centre
_CLEAR_S = 0.5  # the retreating arm's lead before the other one enters the middle
_BESIDE_M = 0.05  # nearer to a place than this is at the place
_GIVE_UP = 5  # failures in a row
_PAST_MIDDLE_M = 0.10  # how far beyond the middle an arm takes the prop straight to its own end


class PickAndPlace(Script):
    """For two arms; `work` carries the scene's first prop one step towards its goal."""

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

    def work(self) -> bool:
        """Carry the prop one step towards its goal; True when it got there."""
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
        try:
            done = self._carry(worker, place)
        except RigError as error:  # a point of the way is out of reach: start again from the waiting pose
            logger.warning("%s", error)
            if worker.holds:
                worker.open()
            done = False
        self._failures = 0 if done else self._failures + 1
        if done and place == self._goal:
            self._rise(worker)  # the way back begins here
        else:
            worker.go_home()
            pause(self.hands, _CLEAR_S)  # come back when the middle is clear
        return done

    def _choose(self, prop: Pose) -> tuple[str | None, str]:
        """Side and place: the goal's own arm carries straight to the goal, the other one to the middle."""
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

    def _carry(self, worker: Worker, place: str) -> bool:
        prop = self.look_at(self._prop.name)
        self.take(worker, prop, _GRIP)
        height = prop.position_m[2]
        target = np.array([*self.setup.places_m[place][:2], height + PUT_DOWN_M])
        # The prop ends square to the table, so that both arms find it the same way.
        if not worker.carry(target, worker.planner.grasp_yaw(target, 0.0), lifted(self._prop.name, height)):
            return False
        worker.open()
        return self._is_at(self.look_at(self._prop.name), place)

    def _rise(self, worker: Worker) -> None:
        position, _ = worker.planner.tool(worker.q)
        try:
            worker.rise(self.height_m - position[2])
        except RigError as error:
            logger.info("%s", error)
