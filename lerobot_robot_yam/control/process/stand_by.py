"""The stand-by: a process that is ready to land the arms if the control process dies.

The stand-by is forked before the control process opens any channel, builds its own models, and then only waits for the
control process to exit and reads the state blocks, 50 times a second. If the control process has exited (kill -9, out
of memory), or is killed by the stand-by because no tick came for a third of the motors' watchdog time (stopped, stuck
in the kernel), the stand-by opens the channels, lands energised arms, and takes the channel locks once the kernel frees
the locks of the dead process.
"""

import contextlib
import logging
import os
import select
import signal
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.impedance import gravity_model
from lerobot_robot_yam.control.loop import ControlLoop
from lerobot_robot_yam.control.mobile import rail_boards
from lerobot_robot_yam.control.preflight.open_bus import close_bus, load_driver, open_bus
from lerobot_robot_yam.control.process.lifeline import ProcessEnd
from lerobot_robot_yam.control.process.robot_loop import introduce, make_blocks, make_controller
from lerobot_robot_yam.damiao.handle_encoder import HANDLE_IDS
from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.mobile.robot_parts import Part
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import HUNG_S
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import BlockPair, lock_path
from lerobot_robot_yam.system.log_thread import log_from_a_thread
from lerobot_robot_yam.system.realtime import avoid_oom_killer, request_realtime
from lerobot_robot_yam.system.runtime_files import FileLock

if TYPE_CHECKING:
    from lerobot_robot_yam.arm.dynamics import GravityModel

logger = logging.getLogger(__name__)

_LOOK_S = 0.02
_CLEARED_MS = 5000  # maximum time for the kernel to free the locks of a dead process
_HUNG_LOOKS = round(HUNG_S / _LOOK_S)  # reads without a new tick; not a time, since a suspended machine makes no reads


def spawn(arms: Sequence[Part], keys: Sequence[str], pairs: Sequence[BlockPair], rt_priority: int) -> int:
    """Fork a stand-by for this process; return the stand-by's pid.

    Call this function before the process opens any channel: the stand-by inherits all open files, such as the blocks.
    """
    control_pid = os.getpid()
    # before the fork, so that both processes share what is loaded for it
    gravity = [gravity_model(arm) if isinstance(arm, ResolvedArm) else None for arm in arms]
    pid = os.fork()
    if pid:
        return pid
    status = 1
    try:
        os.setsid()  # signals to the control process's group must not reach the stand-by
        with open(os.devnull, "r+b") as nothing:
            for descriptor in (0, 1):  # else the caller would never see the control process's output end
                os.dup2(nothing.fileno(), descriptor)
        for name in (signal.SIGINT, signal.SIGHUP, signal.SIGPIPE, signal.SIGTERM):
            signal.signal(name, signal.SIG_IGN)
        avoid_oom_killer()
        with log_from_a_thread():
            StandBy(arms, keys, pairs, gravity, control_pid).run(rt_priority)
        status = 0
    except BaseException:
        logger.exception("stand-by failed")
    finally:
        sys.stderr.flush()
        os._exit(status)  # skips the exit handlers inherited from the control process


class StandBy:
    """Monitor of one control process; lands the arms when that process ends.

    The constructor reads all files in advance, since files may change later.

    Args:
        arms, keys, pairs: arms of the control process, their channel keys, and their shared blocks.
        gravity: gravity model of each arm.
        control_pid: pid of the control process.
    """

    def __init__(
        self,
        arms: Sequence[Part],
        keys: Sequence[str],
        pairs: Sequence[BlockPair],
        gravity: "Sequence[GravityModel | None]",
        control_pid: int,
    ):
        self._arms, self._keys, self._pairs, self._gravity, self._pid = arms, keys, pairs, gravity, control_pid
        named = zip(arms, keys, strict=True)
        self._locks = [FileLock(lock_path(key), f"CAN channel {arm.config.channel}") for arm, key in named]
        self._stop = EmergencyStop()
        self._process = os.pidfd_open(control_pid)
        self._end = ProcessEnd(control_pid)
        self._poll = select.poll()
        self._poll.register(self._process, select.POLLIN)
        for arm in arms:
            load_driver(arm.config.interface)
            if isinstance(arm, ResolvedBase) and arm.config.rail is not None:
                rail_boards.load_board(arm)
        self._records: list[np.ndarray | None] = [None] * len(keys)

    def run(self, rt_priority: int) -> None:
        """Wait for the control process to end; then land the arms that are still energised."""
        request_realtime(rt_priority)
        ticks, idle = -1, 0
        while not (self._poll.poll(_LOOK_S * 1e3) or self._end.reached()):
            before, ticks = ticks, self._look()
            idle = idle + 1 if ticks == before and self._driving() else 0
            if idle >= _HUNG_LOOKS:
                logger.error("the control process (%d) has not ticked for %.2f s: ending it", self._pid, HUNG_S)
                with contextlib.suppress(ProcessLookupError):
                    signal.pidfd_send_signal(self._process, signal.SIGKILL)
                break  # a killed process executes no more code, however long its clean-up takes
        self._look()
        if self._driving():
            self._take_over()

    def _look(self) -> int:
        """Read the newest states; return the highest tick number."""
        newest = 0
        for index, pair in enumerate(self._pairs):
            record = pair.states.glance()  # None: the process was killed during a write
            if record is not None:
                self._records[index] = record
                newest = max(newest, int(record["tick"]))
        return newest

    def _driving(self) -> bool:
        """Return whether any arm is energised."""
        return any(record is not None and record["mode"] not in (Mode.OFF, Mode.OFFLINE) for record in self._records)

    def _take_over(self) -> None:
        begin = time.monotonic()
        logger.error("the control process (%d) has died: taking its arms over and landing them", self._pid)
        controllers, blocks, buses = [], [], []
        for index, (arm, key) in enumerate(zip(self._arms, self._keys, strict=True)):
            record = self._records[index]
            if record is None:
                continue
            try:
                bus = open_bus(arm.config, [*(motor.feedback_id for motor in arm.motors), *HANDLE_IDS])
                buses.append(bus)
                controller = make_controller(arm, bus, self._gravity[index])
                controller.adopt(record, time.monotonic())
                blocks.append(make_blocks(controller, key, self._pairs[index], adopt=record))
                controllers.append(controller)
            except Exception as error:  # the other arm can still be landed
                logger.critical("%s cannot be taken over: %s", arm.name, error)
        try:
            if controllers:
                introduce(controllers)
                loop = ControlLoop(controllers, blocks, self._arms[0].config.rate_hz, stop=self._stop)
                logger.error("taken over within %.0f ms", (time.monotonic() - begin) * 1e3)
                try:
                    loop.run(must_land=lambda: _take(self._locks))
                finally:
                    loop.close()
        finally:
            for bus in buses:
                close_bus(bus)
            self._poll.poll(_CLEARED_MS)
            _take(self._locks)  # a held lock's file is removed on release
            for lock in self._locks:
                lock.release()


def _take(locks: Sequence[FileLock]) -> bool:
    """Acquire the locks that the kernel has freed.

    Always return True: as `must_land`, this makes the arms land, and retry after a fault.
    """
    for lock in locks:
        if not lock.held:
            with contextlib.suppress(ChannelInUseError, OSError):  # a full disk must not end the landing
                lock.acquire()
    return True
