"""Scripts for the scenes' tasks, for the live rig's operator and for lock-step, and the choice of a task's script.

script = make_script(hands, rig.scene(), "lift_and_place")
script.begin()
rig.task("lift_and_place", seed=0)
script.attempt()
rig.task_state()["success"]
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.hands import Hands, Pose, Sight, pause, see
from lerobot_robot_yam.rig.operator.mobile_tables import MobileTables
from lerobot_robot_yam.rig.operator.pick_and_place import PickAndPlace
from lerobot_robot_yam.rig.operator.script import PUT_DOWN_M, Script, Setup, lifted, make_setup
from lerobot_robot_yam.rig.operator.worker import Worker
from lerobot_robot_yam.rig.scene.props import Grip
from lerobot_robot_yam.rig.scene.tasks import SCRIPTS

_DRAWER_AWAY_M = 0.04  # rise of the fingers above the handle of the opened drawer
_PULL_S = 1.2  # duration of the pull
_MIDDLE = "middle"
_HAND_AWAY_M = 0.04
_CLEAR_S = 0.5  # time for the giver to move clear before the bar is moved, s
_PEG_LIFTED_M = 0.02
_HOVER_M = 0.008  # height of the peg's foot above the rim before the peg enters
_AIM_M, _AIM_RAD, _AIMS = 0.0005, 0.02, 6
_ABOVE_M = 0.010
_ENTRIES = 3
_ENTERED_M = 0.008  # depth of the peg's foot from which the peg is in the hole, not on the rim
_PEG_AWAY_M = 0.05


class LiftAndPlace(Script):
    """Script that lifts a prop with the nearest arm and puts it in its region.

    The last stage of success names the prop and its region; the script grasps the prop at the first grip.
    """

    def work(self) -> bool:
        name, goal = self.setup.last.prop, self.goal()
        grip, prop = self.grip_of(name), self.look_at(name)
        point = prop.point(grip.point_m)
        worker = self.workers[self.setup.nearest(point)]
        self.take(worker, prop, grip)
        target = goal.position_m + (point - prop.position_m) + [0.0, 0.0, PUT_DOWN_M]
        yaw = worker.planner.grasp_yaw(target, goal.yaw_rad, grip.turns)
        if not worker.carry(target, yaw, lifted(name, prop.position_m[2])):
            return False
        worker.open()
        return self.lies_at_goal()


class Drawer(Script):
    """Script that opens a drawer by grasping the handle and pulling straight along the drawer's joint.

    The last stage of success names the joint and its range; the drawer's first grip is the handle.
    """

    def work(self) -> bool:
        stage = self.setup.last
        joint = self.setup.things[stage.joint].joint if stage.joint else None
        if joint is None or joint.kind != "slide" or stage.joint_range is None:
            raise ConfigError(f"task {self.setup.task.name}: its last stage needs the joint_range of a slide")
        grip, sight = self.grip_of(stage.joint), see(self.hands)
        front = sight.things[stage.joint]
        point = front.point(grip.point_m)
        worker = self.workers[self.setup.nearest(point)]
        yaw = self.take(worker, front, grip)
        low, high = stage.joint_range
        way = (0.5 * (low + high) - sight.joints[stage.joint]) * joint.axis / np.linalg.norm(joint.axis)
        worker.go(point + front.rotation @ way, yaw, _PULL_S)
        worker.settle()
        worker.open()
        worker.rise(_DRAWER_AWAY_M)
        return bool(low <= see(self.hands).joints[stage.joint] <= high)


class Handover(Script):
    """Script that passes a bar from arm to arm at the place `middle`; the arm nearest to the goal receives the bar.

    The bar is the prop of the last stage of success, and has a grip for each hand.
    """

    height_m = 0.18

    def __init__(self, hands: Hands, setup: Setup):
        super().__init__(hands, setup)
        if len(self.workers) < 2 or _MIDDLE not in setup.places_m:
            raise ConfigError(f"task {setup.task.name}: needs two arms, and a place called {_MIDDLE}")
        self._bar = setup.last.prop

    def work(self) -> bool:
        taker_side = self.setup.nearest(self.goal().position_m)
        (giver_side,) = [side for side in self.workers if side != taker_side]
        giver, taker = self.workers[giver_side], self.workers[taker_side]
        gives, takes = self._grips(giver)
        if not self._offer(giver, taker, gives, takes):
            return False
        self.take(taker, self.look_at(self._bar), takes)
        giver.open()
        giver.rise(_HAND_AWAY_M)
        giver.go_home()
        pause(self.hands, _CLEAR_S)
        return self._lay(taker, takes)

    def _grips(self, giver: Worker) -> tuple[Grip, Grip]:
        """Return two grips: the giver's, which is nearer to the giver's base, and the taker's."""
        bar, base = self.look_at(self._bar), giver.planner.base_m
        both = [self.grip_of(self._bar, number) for number in range(2)]
        near, far = sorted(both, key=lambda grip: float(np.linalg.norm(bar.point(grip.point_m) - base)))
        return near, far

    def _offer(self, giver: Worker, taker: Worker, gives: Grip, takes: Grip) -> bool:
        """Lift the bar and hold it between the arms, aligned with the line between their bases."""
        bar = self.look_at(self._bar)
        yaw = self.take(giver, bar, gives)
        across, along = taker.planner.base_m - giver.planner.base_m, takes.point_m - gives.point_m
        bar_yaw = np.arctan2(across[1], across[0]) - np.arctan2(along[1], along[0])
        target = self.setup.places_m[_MIDDLE] + _turned(gives.point_m, bar_yaw)
        return self._bring(giver, target, yaw + bar_yaw - bar.yaw_rad)

    def _lay(self, taker: Worker, takes: Grip) -> bool:
        """Lay the bar along the goal, in the one of two directions that turns the wrist less."""
        goal, bar = self.goal(), self.look_at(self._bar)
        _, yaw = taker.planner.tool(taker.q)
        ways = []
        for bar_yaw in (goal.yaw_rad, goal.yaw_rad + np.pi):
            target = goal.position_m + _turned(takes.point_m, bar_yaw) + [0.0, 0.0, PUT_DOWN_M]
            tool_yaw = yaw + bar_yaw - bar.yaw_rad
            wrist = (tool_yaw - taker.planner.natural_yaw(target) + np.pi) % (2 * np.pi) - np.pi
            ways.append((abs(wrist), target, tool_yaw))
        _, target, tool_yaw = min(ways, key=lambda way: way[0])
        if not self._bring(taker, target, tool_yaw):
            return False
        taker.open()
        return self.lies_at_goal()

    def _bring(self, worker: Worker, target_m: np.ndarray, yaw_rad: float) -> bool:
        return worker.carry(target_m, yaw_rad, lifted(self._bar, self.setup.things[self._bar].center_m[2]))


def _turned(local_m: np.ndarray, yaw_rad: float) -> np.ndarray:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = local_m
    return np.array([c * x - s * y, s * x + c * y, z])


class Insertion(Script):
    """Script that puts a peg into the hole of a block.

    The last stage of success names the peg as its prop, and the block as its region's frame. The block's first grip is
    the rim of the hole.
    """

    height_m = 0.15

    def __init__(self, hands: Hands, setup: Setup):
        super().__init__(hands, setup)
        region = setup.last.inside
        if region is None or not region.frame:
            raise ConfigError(f"task {setup.task.name}: its last stage needs a region in the frame of the block")
        self._region, self._peg, self._block = region, setup.last.prop, region.frame

    def work(self) -> bool:
        grip, peg = self.grip_of(self._peg), self.look_at(self._peg)
        point = peg.point(grip.point_m)
        worker = self.workers[self.setup.nearest(point)]
        grasp_yaw = self.take(worker, peg, grip)
        rim = self._rim(see(self.hands))
        target = rim.position_m + grip.point_m + [0.0, 0.0, _HOVER_M]
        yaw = worker.planner.grasp_yaw(target, rim.edge_yaw_rad, grip.turns)
        if not worker.carry(target, yaw, lifted(self._peg, peg.position_m[2], _PEG_LIFTED_M)):
            return False
        if not any(self._enter(worker) for _ in range(_ENTRIES)):
            worker.carry(point, grasp_yaw, lambda sight: True)  # back to the peg's place for another try
            worker.open()
            return False
        worker.open()
        worker.rise(_PEG_AWAY_M)
        return self._depth() > _ENTERED_M

    def _rim(self, sight: Sight) -> Pose:
        block = sight.things[self._block]
        return Pose(block.point(self.grip_of(self._block).point_m), block.quat_wxyz)

    def _depth(self) -> float:
        """Return the depth of the peg's foot below the rim, m."""
        sight = see(self.hands)
        return float(self._rim(sight).position_m[2] - sight.things[self._peg].position_m[2])

    def _off(self, sight: Sight) -> tuple[np.ndarray, float]:
        """Return the offset (3,), m, from the peg to a point above the hole, and the smallest aligning turn, rad."""
        peg, rim = sight.things[self._peg], self._rim(sight)
        quarter = np.pi / 2
        turn = (rim.edge_yaw_rad - peg.edge_yaw_rad + quarter / 2) % quarter - quarter / 2
        return rim.position_m + [0.0, 0.0, _HOVER_M] - peg.position_m, float(turn)

    def _enter(self, worker: Worker) -> bool:
        """Align the peg, and lower it into the hole; return False if the peg stands on the rim."""
        worker.approach(self._off, _AIM_M, _AIM_RAD, _AIMS, above_m=_ABOVE_M)
        depth = float(self.grip_of(self._block).point_m[2] - self._region.center_m[2])
        point, yaw = worker.planner.tool(worker.q)
        for below in (_HOVER_M + 1.5 * _ENTERED_M, _HOVER_M + depth):
            worker.go(point - [0.0, 0.0, below], yaw, 0.8)
            worker.settle()
            if self._depth() < _ENTERED_M:
                worker.go(point, yaw)
                return False
        return True


CATALOG: dict[str, type[Script]] = {
    "lift_and_place": LiftAndPlace,
    "handover": Handover,
    "drawer": Drawer,
    "insertion": Insertion,
    "mobile_tables": MobileTables,
    "pick_and_place": PickAndPlace,
}
"""Script class for each name in `tasks.SCRIPTS`, and for `tasks.PICK_AND_PLACE`."""


def make_script(hands: Hands, scene: Mapping[str, Any], task: str) -> Script:
    """Create the script of a task. scene: description of the scene, as returned by `RigOperations.scene`.

    Raises:
        ConfigError: the task is unknown or has no script, or the scene lacks something that the script needs.
    """
    setup = make_setup(scene, task)
    if setup.task.does not in CATALOG:
        raise ConfigError(f"task {task} has no scripted operator; give it a script, one of: {', '.join(SCRIPTS)}")
    return CATALOG[setup.task.does](hands, setup)
