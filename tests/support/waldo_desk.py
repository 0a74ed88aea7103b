"""A controller of Waldo Commander whose time passes only when a test lets it, and requests as clients send them."""

import asyncio
import contextlib

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.waldo.arm_choice import ArmChoice, tool_centre
from lerobot_robot_yam.waldo.controller.command_server import CommandServer
from lerobot_robot_yam.waldo.controller.controller import TICK_S, Controller
from lerobot_robot_yam.waldo.controller.plant import RealArm
from lerobot_robot_yam.waldo.planning.planner import Planner
from tests.support.rigged import isolation_of, sim_config
from tests.support.waiting import QuickClock

HOME_DEG = [0.0, 60.0, 60.0, -29.0, 0.0, 0.0]
PATIENCE_S = 0.05  # real time that planning may take; a request that takes longer waits for the arm


def planner_of(arm="yam", gripper="linear_4310"):
    """The planner of an arm, its tool on."""
    planner = Planner(ArmChoice(arm, gripper).resolved())
    planner.kinematics.tool = tool_centre(planner.hardware.gripper)
    return planner


class WaldoDesk:
    """The controller in simulator mode. Time passes in `run`, and where a request waits for the arm.

    clock: its own, or a rig in lock-step, on which the real arm stands; that one is not armed.
    """

    def __init__(self, clock, hardware, real=None):
        self._clock, self.real = clock, real
        self.controller = Controller(hardware, real, clock.now)
        self.server = CommandServer(self.controller)

    def run(self, seconds):
        """Let time pass, with a tick of the controller every 10 ms."""
        until_s = self._clock.now() + seconds - 1e-6
        while self._clock.now() < until_s:
            self.controller.tick()
            armed = self.real is not None and self.real.armed
            (self.real._session.clock if armed else self._clock).sleep(TICK_S)

    def ask(self, name, **arguments):
        """The answer to a request. Raises YamError: it is refused."""

        async def answered():
            task = asyncio.ensure_future(self.server.request(name, **arguments))
            while not (await asyncio.wait([task], timeout=PATIENCE_S))[0]:
                self.run(TICK_S)
            return task.result()

        return asyncio.run(answered())

    def carry_out(self, index, most_s=100.0):
        """Let time pass until a queued command has ended; how long that took."""
        begun, motion = self._clock.now(), self.controller.motion
        while motion.end_of(index) is None and self._clock.now() < begun + most_s:
            self.run(TICK_S)
        took_s = self._clock.now() - begun
        self.run(TICK_S)  # the reading is of the tick before
        return took_s

    def drive(self):
        """Arm the arm, as an operator would, and have commands move it."""
        self.real.arm()
        self.ask("simulator", enabled=False)
        self.ask("reset")

    def close(self):
        self.server.motions.close()
        if self.real is not None and self.real.armed:
            self.real._session.discard()


@contextlib.contextmanager
def waldo_desk(rig=None, channel=None, **fields):
    """A desk that is thrown away afterwards; without a rig its arm is only simulated."""
    if rig is None:
        desk = WaldoDesk(QuickClock(), ArmChoice(**fields).resolved())
    else:
        config = sim_config(rig, channel, **fields)
        desk = WaldoDesk(rig, ResolvedArm(config), RealArm(config, isolation_of(rig)))
    with contextlib.closing(desk):
        yield desk
