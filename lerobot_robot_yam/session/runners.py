"""Runners of a control loop: in another process, in a thread of the caller, or as steps of a simulated world."""

import json
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from lerobot_robot_yam import errors
from lerobot_robot_yam.control.process.lifeline import Lifeline
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.mobile.robot_parts import Part, plain
from lerobot_robot_yam.state.base_records import map_blocks
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.records import BlockPair, Descriptors
from lerobot_robot_yam.system.clock import START_TIMEOUT_S, SYSTEM, Clock, clock_of

if TYPE_CHECKING:
    import can

    from lerobot_robot_yam.control.loop import ControlLoop

logger = logging.getLogger(__name__)

LAND_TIMEOUT_S = 60.0  # timeout of a landing, s: long enough for the longest descent and one retry
_STOPPED_S = 2.0  # wait before a latched emergency stop is logged, s: a person may release the stop again at once
_HELD = (
    "the arms stay in the air, held or floating, and their control loop lands them when it is released; clear their "
    "way, then `yam-estop release`"
)
_HELD_BY_US = "THIS PROCESS HOLDS THE ARMS, do not end it; clear their way, then `yam-estop release` lands them"


class Runner(Protocol):
    """Interface to one control loop. A runner runs once."""

    @property
    def clock(self) -> Clock:
        """Clock of the caller and of the arms."""

    def note_written(self, arm: int) -> None:
        """Notify the runner that the command block of arm number `arm` was written. Only remote runners use this."""

    def start(self, blocks: Sequence[Descriptors]) -> None:
        """Bring the arms up.

        Args:
            blocks: file descriptors of the blocks, one entry per arm.

        Raises:
            YamError: bring-up failed; no arm is energised.
        """

    def land(self) -> None:
        """Start landing, without waiting. The caller has to call `stop` afterwards."""

    def stop(self, off: Callable[[], bool] = lambda: True) -> bool:
        """Land, end the loop, and wait. Return whether the arms are no longer driven.

        Args:
            off: callback that returns whether torque is off, for arms that the stand-by has taken over.
        """


class ProcessRunner:
    """Runner in another process, which the caller's interpreter cannot disturb."""

    clock: Clock = SYSTEM
    _program = "lerobot_robot_yam.control.process.control_process"

    def __init__(self, arms: Sequence[Part], keys: list[str]):
        self._arms, self._keys = arms, keys
        self._child: subprocess.Popen[bytes] | None = None
        self._lifeline: Lifeline | None = None

    def note_written(self, arm: int) -> None:
        pass

    def start(self, blocks: Sequence[Descriptors]) -> None:
        self._lifeline = lifeline = Lifeline()
        self._child = child = subprocess.Popen(
            [sys.executable, "-P", "-m", self._program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[lifeline.far_end, *(descriptor for pair in blocks for descriptor in pair)],
            start_new_session=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        job = {
            **self._job(),
            "keys": self._keys,
            "blocks": blocks,
            "lifeline": lifeline.far_end,
            "parent_pid": os.getpid(),
        }
        lifeline.hand_over()
        assert child.stdin is not None and child.stdout is not None
        child.stdin.write(json.dumps(job).encode() + b"\n")
        child.stdin.close()
        answered = select.poll()  # not select.select, which refuses descriptors above 1023
        answered.register(child.stdout, select.POLLIN)
        if not answered.poll(START_TIMEOUT_S * 1e3):
            raise YamError(f"the control process did not come up within {START_TIMEOUT_S:.0f} s")
        line = child.stdout.readline()
        if not line:
            raise YamError(f"the control process died while starting (exit status {child.wait()}); see its log above")
        reply = json.loads(line)
        if "error" in reply:
            raise getattr(errors, reply["kind"], YamError)(reply["error"])

    def _job(self) -> dict[str, Any]:
        """Return the description of the arms as plain values; `start` adds the connections to the caller."""
        return {"parts": [plain(part) for part in self._arms]}

    def land(self) -> None:
        if self._child is not None and self._child.poll() is None:
            self._child.send_signal(signal.SIGTERM)

    def stop(self, off: Callable[[], bool] = lambda: True) -> bool:
        self.land()
        child, self._child = self._child, None
        lifeline = self._lifeline
        if child is None or lifeline is None:
            return True
        # if this is process 1, its end ends the container
        ended = wait_patiently(lambda: child.poll() is not None, outlives_us=os.getpid() != 1)
        if child.stdout is not None:
            child.stdout.close()
        if ended:  # a stand-by may have taken over the arms
            ended = wait_patiently(lambda: off() or lifeline.cut, outlives_us=True)
        lifeline.close()
        return ended


class ThreadRunner:
    """Runner in a thread of the caller, for debugging."""

    clock: Clock = SYSTEM

    def __init__(self, arms: Sequence[Part], keys: list[str]):
        self._parts = arms
        self._land = threading.Event()
        self._settled = threading.Event()
        self._error: BaseException | None = None
        self._blocks: list[BlockPair] = []
        self._thread = threading.Thread(target=self._run, args=(arms, keys), name="yam-control", daemon=False)

    def _run(self, arms: Sequence[Part], keys: list[str]) -> None:
        from lerobot_robot_yam.control.process.control_process import control

        try:
            control(arms, keys, self._blocks, self._tell, self._must_land, realtime=False)
        except BaseException as error:
            self._error = error
            if self._settled.is_set():
                logger.exception("control loop failed")
        finally:
            self._settled.set()

    def _must_land(self) -> bool:
        return self._land.is_set() or not threading.main_thread().is_alive()

    def _tell(self, failure: str) -> None:
        self._error = errors.MotorError(failure) if failure else None
        self._settled.set()

    def note_written(self, arm: int) -> None:
        pass

    def start(self, blocks: Sequence[Descriptors]) -> None:
        self._blocks = [map_blocks(part, pair.copies()) for part, pair in zip(self._parts, blocks, strict=True)]
        self._thread.start()
        if not self._settled.wait(START_TIMEOUT_S):
            raise YamError(f"the control loop did not come up within {START_TIMEOUT_S:.0f} s")
        if self._error is not None:
            raise self._error

    def land(self) -> None:
        self._land.set()

    def stop(self, off: Callable[[], bool] = lambda: True) -> bool:
        self.land()
        return self._thread.ident is None or wait_patiently(lambda: not self._thread.is_alive(), outlives_us=False)


class StepRunner:
    """Runner that ticks while the caller sleeps. The runner is the caller's clock.

    The runner owns the simulated world, so discarding that world with arms in the air is harmless.
    """

    def __init__(self, arms: Sequence[Part], keys: list[str]):
        self._arms, self._keys = arms, keys
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
        """Return the simulated time, s."""
        return self._world.now()

    def sleep(self, seconds: float) -> None:
        """Run ticks of the loop for `seconds` of simulated time."""
        until_s = self._world.now() + seconds
        while self._world.now() < until_s:
            if next(self._ticks, False) is False:  # the arms are off, or have failed
                self._world.sleep(max(0.0, until_s - self._world.now()))

    def note_written(self, arm: int) -> None:
        pass

    def start(self, blocks: Sequence[Descriptors]) -> None:
        from lerobot_robot_yam.control.preflight.open_bus import open_bus
        from lerobot_robot_yam.control.process.robot_loop import build  # late import: only this runner needs the module

        try:
            for arm in self._arms:
                self._buses.append(open_bus(arm.config))
            self._world = clock_of(self._buses[0])
            self._pairs = [map_blocks(part, pair.copies()) for part, pair in zip(self._arms, blocks, strict=True)]
            self._loop = build(self._arms, self._keys, self._buses, self._pairs)
            self._loop.start()
            ready: list[str] = []
            self._ticks = self._loop.ticks(ready.append, lambda: self._landing)
            give_up_s = self._world.now() + START_TIMEOUT_S
            while not ready or ready[0]:  # after a failed start the arms land before `ticks` raises
                next(self._ticks)
                if self._world.now() > give_up_s:
                    raise YamError(f"the control loop did not come up within {START_TIMEOUT_S:.0f} s")
        except BaseException:
            self.discard()
            raise

    def land(self) -> None:
        self._landing = True

    def stop(self, off: Callable[[], bool] = lambda: True) -> bool:
        """Land in simulated time and discard the world in any case. Return whether the arms have landed."""
        self.land()
        landed = True
        give_up_s = self._world.now() + LAND_TIMEOUT_S
        for _ in self._ticks:
            if self._world.now() > give_up_s:
                logger.error("the arms do not land; their world is thrown away")
                landed = False
                break
        self.discard()
        return landed

    def discard(self) -> None:
        """End at once, without landing. Idempotent."""
        self._ticks = iter(())
        loop, self._loop = self._loop, None
        if loop is not None:
            loop.close()
        for pair in self._pairs:
            pair.close()
        buses, self._buses = self._buses, []
        for bus in buses:
            bus.shutdown()


def wait_patiently(done: Callable[[], bool], outlives_us: bool) -> bool:
    """Wait for a landing. Return whether the arms have landed. Ctrl-C is only logged: aborting would drop an arm.

    Args:
        done: callback that returns whether the arms have landed.
        outlives_us: whether the control loop outlives this process; if so, a latched emergency stop ends the wait.
    """
    begin, told = time.monotonic(), False
    while True:
        try:
            while not done():
                waited_s = time.monotonic() - begin
                if waited_s > _STOPPED_S and not told and _stopped():
                    told = True
                    logger.error("the emergency stop is latched: %s", _HELD if outlives_us else _HELD_BY_US)
                    if outlives_us:
                        return False
                if waited_s > LAND_TIMEOUT_S:
                    logger.error("the arms are not down yet; their control loop goes on holding and landing by itself")
                    return False
                time.sleep(0.01)
            return True
        except KeyboardInterrupt:
            logger.warning("landing; the arms have no brakes, so this cannot be cut short")


def _stopped() -> bool:
    try:
        return EmergencyStop().latched
    except errors.ConfigError:  # the runtime directory was removed; the control loop latches the stop without it
        return False
