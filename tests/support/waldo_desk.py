"""A controller of Waldo Commander with an arm on a rig in lock-step, and requests as clients send them."""

import asyncio
import contextlib

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.waldo.controller.command_server import CommandServer
from lerobot_robot_yam.waldo.controller.controller import TICK_S, Controller
from lerobot_robot_yam.waldo.controller.real_arm import RealArm
from tests.support.rigged import isolation_of, sim_config


class WaldoDesk:
    """The controller in simulator mode, its arm not armed. Time passes in `run`, and while a request is answered."""

    def __init__(self, rig, channel, **fields):
        self._rig, config = rig, sim_config(rig, channel, **fields)
        self.real = RealArm(config, isolation_of(rig))
        self.controller = Controller(ResolvedArm(config), self.real, rig.now)
        self.server = CommandServer(self.controller)

    def run(self, seconds):
        """Let time pass, with a tick of the controller every 10 ms."""
        until_s = self._rig.now() + seconds - 1e-6
        while self._rig.now() < until_s:
            self.controller.tick()
            (self.real._session.clock if self.real.armed else self._rig).sleep(TICK_S)

    def ask(self, name, **arguments):
        """The answer to a request. Raises YamError: it is refused."""

        async def answered():
            task = asyncio.ensure_future(self.server.request(name, **arguments))
            while not task.done():
                self.run(TICK_S)
                await asyncio.sleep(0)
            return task.result()

        return asyncio.run(answered())

    def drive(self):
        """Arm the arm, as an operator would, and have commands move it."""
        self.real.arm()
        self.ask("simulator", enabled=False)
        self.ask("reset")

    def close(self):
        self.server.motions.close()
        if self.real.armed:
            self.real._session.discard()


@contextlib.contextmanager
def waldo_desk(rig, channel, **fields):
    """A desk that is thrown away afterwards."""
    with contextlib.closing(WaldoDesk(rig, channel, **fields)) as desk:
        yield desk
