"""Puts one fault into the backend, in all its processes: the environment variable YAM_SEED names it.

Python imports this module by itself at its start where this folder is on its path.
"""

import importlib.abc
import importlib.util
import os
import sys

W = "lerobot_robot_yam.waldo."


def constructor_without_kwargs(robot):
    made = robot.Robot.__init__
    robot.Robot.__init__ = lambda self: made(self)


def lower_case_tool_key(arm_choice):
    key = arm_choice.tool_key
    arm_choice.tool_key = lambda gripper: key(gripper).lower()


def io_of_five(status_stream):
    write = status_stream.StatusBuffer.write

    def five(self, message):
        self.io = self.io[:1]
        write(self, message)
        self.io = self.io.repeat(5)

    status_stream.StatusBuffer.write = five


def metres_in_pose(status_report):
    status = status_report.StatusReport.status

    def in_metres(self):
        told = status(self)
        for place in (3, 7, 11):
            told["pose"][place] /= 1000.0
        return told

    status_report.StatusReport.status = in_metres


def resume_replays_a_cancelled_move(controller):
    estop, reset = controller.Controller.estop, controller.Controller.reset

    def remembering(self):
        self.cancelled = list(self.motion.waiting)
        return estop(self)

    def replaying(self):
        code = reset(self)
        for command in self.__dict__.pop("cancelled", []):
            command.plan = self.planner.joints(self.motion.end_q, command.plan.q[-1])
            self.motion.add(command, self.motion.epoch)
        return code

    controller.Controller.estop, controller.Controller.reset = remembering, replaying


def jog_without_expiry(jog):
    jog._duration = lambda duration_s: 1e9


def nan_jog(jog):
    jog._signed_share = float


def inverted_gripper(status_report):
    status_report.swapped = lambda position: position


def served_on_every_address(command_server):
    opened = command_server.CommandServer.open
    command_server.CommandServer.open = lambda self, host, port: opened(self, "0.0.0.0", port)


def orphaned_controller(lifeline):
    lifeline.ProcessEnd.reached = lambda self: False


SEEDS = {
    constructor_without_kwargs: W + "robot",
    lower_case_tool_key: W + "arm_choice",
    io_of_five: W + "client.status_stream",
    metres_in_pose: W + "controller.status_report",
    resume_replays_a_cancelled_move: W + "controller.controller",
    jog_without_expiry: W + "planning.jog",
    nan_jog: W + "planning.jog",
    inverted_gripper: W + "controller.status_report",
    served_on_every_address: W + "controller.command_server",
    orphaned_controller: "lerobot_robot_yam.control.process.lifeline",
}


class Seeder(importlib.abc.MetaPathFinder):
    """Has the fault put in right after its module has been loaded."""

    def __init__(self, seed, module):
        self.seed, self.module = seed, module

    def find_spec(self, name, path, target=None):
        if name != self.module:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module

        def load_and_seed(module):
            load(module)
            self.seed(module)

        spec.loader.exec_module = load_and_seed
        return spec


for _seed, _module in SEEDS.items():
    if _seed.__name__ == os.environ.get("YAM_SEED"):
        sys.meta_path.insert(0, Seeder(_seed, _module))
