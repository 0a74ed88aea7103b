"""Put a peg into a hole: aim by the peg itself, which sits in the fingers as it happens to, then lower it."""

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.hands import Hands, Pose, Sight, see
from lerobot_robot_yam.rig.operator.scripts.script import Script, Setup, lifted
from lerobot_robot_yam.rig.operator.worker import Worker

_LIFTED_M = 0.02
_HOVER_M = 0.008  # of the peg's foot above the rim
_AIM_M, _AIM_RAD, _AIMS = 0.0005, 0.02, 6
_ABOVE_M = 0.010
_ENTRIES = 3
_ENTERED_M = 0.008  # deeper than this it is in the hole, not on its rim
_AWAY_M = 0.05


class Insertion(Script):
    """Peg and block are prop and frame of the last stage of success; the hole's rim is the block's first grip."""

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
        if not worker.carry(target, yaw, lifted(self._peg, peg.position_m[2], _LIFTED_M)):
            return False
        if not any(self._enter(worker) for _ in range(_ENTRIES)):
            worker.carry(point, grasp_yaw, lambda sight: True)  # back to where it stood, to take it anew
            worker.open()
            return False
        worker.open()
        worker.rise(_AWAY_M)
        return self._depth() > _ENTERED_M

    def _rim(self, sight: Sight) -> Pose:
        block = sight.things[self._block]
        return Pose(block.point(self.grip_of(self._block).point_m), block.quat_wxyz)

    def _depth(self) -> float:
        """How far below the rim the foot is."""
        sight = see(self.hands)
        return float(self._rim(sight).position_m[2] - sight.things[self._peg].position_m[2])

    def _off(self, sight: Sight) -> tuple[np.ndarray, float]:
        """From the peg to above the hole, and the least turn that fits."""
        peg, rim = sight.things[self._peg], self._rim(sight)
        quarter = np.pi / 2
        turn = (rim.edge_yaw_rad - peg.edge_yaw_rad + quarter / 2) % quarter - quarter / 2
        return rim.position_m + [0.0, 0.0, _HOVER_M] - peg.position_m, float(turn)

    def _enter(self, worker: Worker) -> bool:
        """Aim, and down into the hole; False when it stands on the rim."""
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
