"""Lift a prop with the nearest arm and put it where it belongs."""

from lerobot_robot_yam.rig.operator.scripts.script import PUT_DOWN_M, Script, lifted


class LiftAndPlace(Script):
    """Prop and region are those of the last stage of success; the prop is taken by its first grip."""

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
