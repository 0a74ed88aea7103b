"""Open a drawer: take its handle and pull it straight along its joint."""

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.hands import see
from lerobot_robot_yam.rig.operator.scripts.script import Script

_AWAY_M = 0.04
_PULL_S = 1.2


class Drawer(Script):
    """Joint and opening are those of the last stage of success; the handle is the first grip."""

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
