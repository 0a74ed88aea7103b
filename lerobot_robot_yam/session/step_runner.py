"""A control loop that its caller ticks, for arms in a world that is simulated in lock-step."""

import logging
from collections.abc import Callable, Iterator, Sequence

import can

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.control.loop import ControlLoop
from lerobot_robot_yam.control.loop_builder import build
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.block_pair import BlockPair, Descriptors
from lerobot_robot_yam.system.clock import SYSTEM, Clock, clock_of

logger = logging.getLogger(__name__)

_START_TIMEOUT_S = 60.0
_LAND_TIMEOUT_S = 60.0


class StepRunner:
    """A `runners.Runner` that is also the caller's clock: while the caller sleeps, the loop ticks.

    The world is the caller's own. When it is thrown away with arms in the air, nothing falls.
    """

    def __init__(self, configs: list[ArmConfig], keys: list[str]):
        self._configs, self._keys = configs, keys
        self._buses: list[can.BusABC] = []
        self._pairs: list[BlockPair] = []
        self._loop: ControlLoop | None = None
        self._ticks: Iterator[None] = iter(())
        self._world: Clock = SYSTEM
        self._landing = False

    @property
    def clock(self) -> Clock:
        return self

    def now(self) -> float:
        """The world's time in s."""
        return self._world.now()

    def sleep(self, seconds: float) -> None:
        """Simulate, with a control loop that ticks in it."""
        until_s = self._world.now() + seconds
        while self._world.now() < until_s:
            if next(self._ticks, False) is False:  # the arms are off, or have failed
                self._world.sleep(max(0.0, until_s - self._world.now()))

    def start(self, blocks: Sequence[Descriptors]) -> None:
        """Bring the arms up; `blocks` of each, in the order of their configs.

        Raises:
            YamError: what failed.
        """
        try:
            for config in self._configs:
                self._buses.append(open_bus(config))
            self._world = clock_of(self._buses[0])
            self._pairs = [BlockPair.of(descriptors.copies()) for descriptors in blocks]
            self._loop = build(self._configs, self._keys, self._buses, self._pairs)
            self._loop.start()
            ready: list[str] = []
            self._ticks = self._loop.ticks(ready.append, lambda: self._landing)
            give_up_s = self._world.now() + _START_TIMEOUT_S
            while not ready or ready[0]:  # what has failed lands first
                next(self._ticks)
                if self._world.now() > give_up_s:
                    raise YamError(f"the control loop did not come up within {_START_TIMEOUT_S:.0f} s")
        except BaseException:
            self.discard()
            raise

    def stop(self, off: Callable[[], bool] = lambda: True) -> bool:
        """Land, in simulated time; False when that does not end."""
        self._landing, landed = True, True
        give_up_s = self._world.now() + _LAND_TIMEOUT_S
        for _ in self._ticks:
            if self._world.now() > give_up_s:
                logger.error("the arms do not land; their world is thrown away")
                landed = False
                break
        self.discard()
        return landed

    def discard(self) -> None:
        """End at once, as the world does. Idempotent."""
        self._ticks = iter(())
        loop, self._loop = self._loop, None
        if loop is not None:
            loop.close()
        for pair in self._pairs:
            pair.close()
        buses, self._buses = self._buses, []
        for bus in buses:
            bus.shutdown()
