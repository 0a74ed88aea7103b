"""Lift a prop with the nearest arm and put it where it belongs."""

import numpy as np

from lerobot_robot_yam.rig.operator.scripts.script import Script, grip_yaw

_LIFTED_M = 0.03
_PUT_DOWN_M = 0.002


class LiftAndPlace(Script):
    """The prop and where it goes are those of the last stage of success; it is taken by its first grip."""

    def work(self) -> bool:
        name, region, goal = self.setup.last.prop, self.setup.last.inside, self.goal()
        grip, prop = self.grip_of(name), self.look_at(name)
        point = prop.point(grip.point_m)
        worker = self.workers[self.setup.nearest(point)]
        worker.reach(point, worker.planner.grasp_yaw(point, grip_yaw(grip, prop), grip.turns))
        worker.close()
        begin = prop.position_m[2]
        target = goal.position_m + (point - prop.position_m) + [0.0, 0.0, _PUT_DOWN_M]
        yaw = worker.planner.grasp_yaw(target, goal.yaw_rad, grip.turns)
        if not worker.carry(target, yaw, lambda sight: sight.things[name].position_m[2] - begin > _LIFTED_M):
            return False
        worker.open()
        assert region is not None
        off = self.look_at(name).position_m - goal.position_m
        return bool(np.linalg.norm(off[:2]) < region.radius_m)
