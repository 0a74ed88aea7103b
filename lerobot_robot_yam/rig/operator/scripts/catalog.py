"""Which script does which task, and the two shortest scripts; for the live rig's operator and in lock-step.

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
from lerobot_robot_yam.rig.operator.hands import Hands, see
from lerobot_robot_yam.rig.operator.scripts.handover import Handover
from lerobot_robot_yam.rig.operator.scripts.insertion import Insertion
from lerobot_robot_yam.rig.operator.scripts.pick_and_place import PickAndPlace
from lerobot_robot_yam.rig.operator.scripts.script import PUT_DOWN_M, Script, lifted, make_setup
from lerobot_robot_yam.rig.scene.tasks import SCRIPTS

_AWAY_M = 0.04  # the fingers rise so far from the handle of an open drawer
_PULL_S = 1.2  # to open it


class LiftAndPlace(Script):
    """Lift a prop with the nearest arm and put it where it belongs.

    Prop and region are those of the last stage of success; the prop is taken by its first grip.
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
    """Open a drawer: take its handle and pull it straight along its joint.

    Joint and opening are those of the last stage of success; the handle is the first grip.
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
        worker.rise(_AWAY_M)
        return bool(low <= see(self.hands).joints[stage.joint] <= high)


CATALOG: dict[str, type[Script]] = {
    "lift_and_place": LiftAndPlace,
    "handover": Handover,
    "drawer": Drawer,
    "insertion": Insertion,
    "pick_and_place": PickAndPlace,
}
"""A class for each of `tasks.SCRIPTS`, and the endless one for `tasks.PICK_AND_PLACE`."""


def make_script(hands: Hands, scene: Mapping[str, Any], task: str) -> Script:
    """The script of a task of a scene as `RigOperations.scene` returns it.

    Raises:
        ConfigError: there is no such task, or the scene lacks something that the operator needs.
    """
    setup = make_setup(scene, task)
    if setup.task.does not in CATALOG:
        raise ConfigError(f"task {task} has no scripted operator; give it a script, one of: {', '.join(SCRIPTS)}")
    return CATALOG[setup.task.does](hands, setup)
