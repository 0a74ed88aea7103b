"""The scripted operator's task: carry one prop from place A to B and back, handing it over in the middle, for ever.

It decides from what it sees, each time anew: whoever reaches the prop takes it one step towards its goal. So a missed
grasp, a slipped or a displaced prop needs no special case.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.guidance import Guide, Hands, Sight
from lerobot_robot_yam.rig.plan import ArmPlanner

logger = logging.getLogger(__name__)

_LIFTED_M = 0.03
_AIM_M = 0.006
_AIMS = 3
_BIAS_M = 0.03
_PUT_DOWN_M = 0.002
_CLEAR_S = 0.5  # the retreating arm's lead before the other one enters the middle
_BESIDE_M = 0.05  # nearer to a place than this is at the place
_GIVE_UP = 5  # failures in a row


@dataclass(frozen=True)
class Layout:
    """Where things go, in the world frame.

    Attributes:
        places_m: name → (x, y); "A" on the left, "M" in both arms' reach, "B" on the right.
        homes_m: side → (x, y, z) of the waiting tool.
        half_m: half the prop's height.
        height_m: height of the tool while it carries.
    """

    places_m: Mapping[str, tuple[float, float]]
    homes_m: Mapping[str, tuple[float, float, float]]
    half_m: float = 0.02
    height_m: float = 0.125


class PickAndPlace:
    """The task for two arms; `run` does it until the arms are switched off."""

    def __init__(self, hands: Hands, planners: Mapping[str, ArmPlanner], layout: Layout):
        self._hands = hands
        self._planners = planners
        self._layout = layout
        self._homes = {
            side: planners[side].pose(np.asarray(home, float), planners[side].natural_yaw(np.asarray(home)))
            for side, home in layout.homes_m.items()
        }
        self._guide = Guide(hands, planners)
        self._bias = {side: np.zeros(3) for side in planners}  # from where the tool is to where it was sent
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
        sight = self._guide.see()
        self._guide.forget()
        for side, planner in self._planners.items():
            self._guide.send(side, planner.unfold(sight.leader_rad[side], self._homes[side]))
        for side in self._planners:
            self._guide.follow_to_end(side)

    def step(self) -> bool:
        """Carry the prop one step towards its goal; True when it got there."""
        sight = self._guide.see()
        if self._is_at(sight.prop_m, self._goal):
            self._goal = "A" if self._goal == "B" else "B"
        side, place = self._choose(sight)
        if side is None or self._failures >= _GIVE_UP:
            logger.warning("the prop at %s cannot be taken; putting it back", np.round(sight.prop_m, 3))
            self._failures = 0
            self._guide.pause(1.0)
            self._hands.put_back(np.array([*self._layout.places_m["A"], self._layout.half_m]))
            self._guide.pause(0.5)
            return False
        try:
            done = self._carry(side, place)
        except RigError as error:  # a point of the way is out of reach: start again from the waiting pose
            logger.warning("%s", error)
            if self._guide.trigger[side] > 0.0:
                self._guide.squeeze(side, 0.0)
            done = False
        self._failures = 0 if done else self._failures + 1
        if done and place == self._goal:
            self._rise(side)  # the way back begins here
        else:
            self._go_home(side)
        return done

    def _choose(self, sight: Sight) -> tuple[str | None, str]:
        """Who carries it where: the goal's own arm straight to the goal, the other one to the middle."""
        finisher, helper = ("right", "left") if self._goal == "B" else ("left", "right")
        if sight.prop_m[2] > -self._layout.half_m:
            towards = sight.prop_m[1] if finisher == "left" else -sight.prop_m[1]
            for side, place in ((finisher, self._goal), (helper, "M")):
                if (side == helper or towards > -0.10) and self._can_take(side, sight):
                    if not self._is_at(sight.prop_m, place):
                        return side, place
        return None, ""

    def _can_take(self, side: str, sight: Sight) -> bool:
        planner = self._planners[side]
        point = sight.prop_m
        yaw = planner.grasp_yaw(point, sight.prop_yaw_rad)
        above = np.array([*point[:2], self._layout.height_m])
        return planner.reaches(point, yaw) and planner.reaches(above, yaw)

    def _is_at(self, position_m: np.ndarray, place: str) -> bool:
        return bool(np.linalg.norm(position_m[:2] - np.asarray(self._layout.places_m[place])) < _BESIDE_M)

    def _carry(self, side: str, place: str) -> bool:
        planner, height = self._planners[side], self._layout.height_m
        sight = self._guide.see()
        point = sight.prop_m
        yaw = planner.grasp_yaw(point, sight.prop_yaw_rad)
        self._guide.send(side, planner.transfer(self._guide.q[side], point + self._bias[side], yaw, height))
        self._guide.follow_to_end(side)
        self._aim(side, point, yaw)
        self._guide.squeeze(side, 1.0)
        target = np.array([*self._layout.places_m[place], point[2] + _PUT_DOWN_M]) + self._bias[side]
        # The prop ends square to the table, so that both arms find it the same way.
        path = planner.transfer(self._guide.q[side], target, planner.grasp_yaw(target, 0.0), height)
        self._guide.send(side, path)
        self._guide.follow(side, 0.5 * path.duration_s)
        if self._guide.see().prop_m[2] - sight.prop_m[2] < _LIFTED_M:
            logger.info("missed the prop with the %s hand; trying again", side)
            self._guide.stop(side)
            self._guide.squeeze(side, 0.0)
            return False
        self._guide.follow_to_end(side)
        self._guide.settle(side)
        self._guide.squeeze(side, 0.0)
        return self._is_at(self._guide.see().prop_m, place)

    def _rise(self, side: str) -> None:
        planner = self._planners[side]
        position, yaw = planner.tool(self._guide.q[side])
        q = planner.solve(np.array([*position[:2], self._layout.height_m]), yaw, self._guide.q[side])
        if q is not None:
            self._guide.send(side, planner.joint_move(self._guide.q[side], q))

    def _go_home(self, side: str) -> None:
        """Start towards the waiting pose; come back when the middle is clear."""
        planner = self._planners[side]
        home = np.asarray(self._layout.homes_m[side], float)
        try:
            path = planner.transfer(self._guide.q[side], home, planner.natural_yaw(home), self._layout.height_m)
        except RigError:
            path = planner.joint_move(self._guide.q[side], self._homes[side])
        self._guide.send(side, path)
        self._guide.pause(_CLEAR_S)

    def _aim(self, side: str, point: np.ndarray, yaw: float) -> None:
        """Bring the follower's tool to the point itself: friction and imperfect gravity compensation keep it a few
        millimetres off. What was off once is allowed for the next time.
        """
        planner = self._planners[side]
        for _ in range(_AIMS):
            self._guide.settle(side)
            off = point - planner.tool(self._guide.see().follower_rad[side])[0]
            if np.abs(off).max() < _AIM_M:
                return
            self._bias[side] = np.clip(self._bias[side] + off, -_BIAS_M, _BIAS_M)
            q = planner.solve(point + self._bias[side], yaw, self._guide.q[side])
            if q is None:
                return
            self._guide.send(side, planner.joint_move(self._guide.q[side], q))
            self._guide.follow_to_end(side)
