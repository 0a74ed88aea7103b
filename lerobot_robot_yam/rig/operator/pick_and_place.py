"""The scripted operator's task: carry one prop from place A to B and back, handing it over in the middle, for ever.

It decides from what it sees, each time anew: whoever reaches the prop takes it one step towards its goal. So a missed
grasp, a slipped or a displaced prop needs no special case.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.operator.guidance import Guide, Hands
from lerobot_robot_yam.rig.operator.plan import ArmPlanner
from lerobot_robot_yam.rig.operator.sight import Pose
from lerobot_robot_yam.rig.operator.worker import Worker

logger = logging.getLogger(__name__)

_LIFTED_M = 0.03
_PUT_DOWN_M = 0.002
_CLEAR_S = 0.5  # the retreating arm's lead before the other one enters the middle
_BESIDE_M = 0.05  # nearer to a place than this is at the place
_GIVE_UP = 5  # failures in a row


@dataclass(frozen=True)
class Layout:
    """Where things go, in the world frame.

    Attributes:
        prop: name of what is carried.
        places_m: name → (x, y); "A" on the left, "M" in both arms' reach, "B" on the right.
        homes_m: side → (x, y, z) of the waiting tool.
        half_m: half the prop's height.
        height_m: height of the tool while it carries.
    """

    prop: str
    places_m: Mapping[str, tuple[float, float]]
    homes_m: Mapping[str, tuple[float, float, float]]
    half_m: float = 0.02
    height_m: float = 0.125


class PickAndPlace:
    """The task for two arms; `run` does it until the arms are switched off."""

    def __init__(self, hands: Hands, planners: Mapping[str, ArmPlanner], layout: Layout):
        self._hands = hands
        self._layout = layout
        self._guide = Guide(hands, planners)
        self._workers = {
            side: Worker(self._guide, side, planner, np.array(layout.homes_m[side]), layout.height_m)
            for side, planner in planners.items()
        }
        self._goal = "B"
        self._failures = 0

    def run(self) -> None:
        """Take the leaders to their waiting poses, then carry for ever.

        Raises:
            Interrupted: the arms were switched off. The hands have let go.
        """
        try:
            self.begin()
            while True:
                self.step()
        finally:
            self._hands.let_go()

    def begin(self) -> None:
        """Take both leaders from wherever they are to their waiting poses."""
        self._guide.forget()
        for worker in self._workers.values():
            worker.unfold()
        for worker in self._workers.values():
            worker.wait()

    def step(self) -> bool:
        """Carry the prop one step towards its goal; True when it got there."""
        prop = self._see()
        if self._is_at(prop, self._goal):
            self._goal = "A" if self._goal == "B" else "B"
        side, place = self._choose(prop)
        if side is None or self._failures >= _GIVE_UP:
            logger.warning("the prop at %s cannot be taken; putting it back", np.round(prop.position_m, 3))
            self._failures = 0
            self._guide.pause(1.0)
            self._hands.put_back(np.array([*self._layout.places_m["A"], self._layout.half_m]))
            self._guide.pause(0.5)
            return False
        worker = self._workers[side]
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
            self._guide.pause(_CLEAR_S)  # come back when the middle is clear
        return done

    def _see(self) -> Pose:
        return self._guide.see().things[self._layout.prop]

    def _choose(self, prop: Pose) -> tuple[str | None, str]:
        """Who carries it where: the goal's own arm straight to the goal, the other one to the middle."""
        finisher, helper = ("right", "left") if self._goal == "B" else ("left", "right")
        if prop.position_m[2] > -self._layout.half_m:
            towards = prop.position_m[1] if finisher == "left" else -prop.position_m[1]
            for side, place in ((finisher, self._goal), (helper, "M")):
                if (side == helper or towards > -0.10) and self._can_take(side, prop):
                    if not self._is_at(prop, place):
                        return side, place
        return None, ""

    def _can_take(self, side: str, prop: Pose) -> bool:
        planner = self._workers[side].planner
        point = prop.position_m
        yaw = planner.grasp_yaw(point, prop.edge_yaw_rad)
        above = np.array([*point[:2], self._layout.height_m])
        return planner.reaches(point, yaw) and planner.reaches(above, yaw)

    def _is_at(self, prop: Pose, place: str) -> bool:
        return bool(np.linalg.norm(prop.position_m[:2] - np.asarray(self._layout.places_m[place])) < _BESIDE_M)

    def _carry(self, worker: Worker, place: str) -> bool:
        prop = self._see()
        point = prop.position_m
        worker.reach(point, worker.planner.grasp_yaw(point, prop.edge_yaw_rad))
        worker.close()
        target = np.array([*self._layout.places_m[place], point[2] + _PUT_DOWN_M])
        # The prop ends square to the table, so that both arms find it the same way.
        yaw = worker.planner.grasp_yaw(target, 0.0)
        name = self._layout.prop
        if not worker.carry(target, yaw, lambda sight: sight.things[name].position_m[2] - point[2] > _LIFTED_M):
            return False
        worker.open()
        return self._is_at(self._see(), place)

    def _rise(self, worker: Worker) -> None:
        position, _ = worker.planner.tool(self._guide.q[worker.side])
        try:
            worker.rise(self._layout.height_m - position[2])
        except RigError as error:
            logger.info("%s", error)
