"""Which script does which task: for the live rig's operator and for a demonstrator in lock-step.

script = make_script(hands, rig.scene(), "lift_and_place")
script.begin()
rig.task("lift_and_place", seed=0)
script.attempt()
rig.task_state()["success"]
"""

from collections.abc import Mapping
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.hands import Hands
from lerobot_robot_yam.rig.operator.scripts.drawer import Drawer
from lerobot_robot_yam.rig.operator.scripts.handover import Handover
from lerobot_robot_yam.rig.operator.scripts.insertion import Insertion
from lerobot_robot_yam.rig.operator.scripts.lift_and_place import LiftAndPlace
from lerobot_robot_yam.rig.operator.scripts.pick_and_place import PickAndPlace
from lerobot_robot_yam.rig.operator.scripts.script import Script
from lerobot_robot_yam.rig.operator.scripts.setup import make_setup
from lerobot_robot_yam.rig.scene.tasks import SCRIPTS

CATALOG: dict[str, type[Script]] = {
    "lift_and_place": LiftAndPlace,
    "handover": Handover,
    "drawer": Drawer,
    "insertion": Insertion,
    "pick_and_place": PickAndPlace,
}
"""A class for each of `tasks.SCRIPTS`, and the endless one for `tasks.PICK_AND_PLACE`."""


def make_script(hands: Hands, scene: Mapping[str, Any], task: str) -> Script:
    """The script of a task of the scene, as `control.RigOperations.scene` tells it.

    Raises:
        ConfigError: there is no such task, or the scene lacks something that the operator needs.
    """
    setup = make_setup(scene, task)
    if setup.task.does not in CATALOG:
        raise ConfigError(f"task {task} has no scripted operator; give it a script, one of: {', '.join(SCRIPTS)}")
    return CATALOG[setup.task.does](hands, setup)
