"""The control process: `python -m lerobot_robot_yam.control.process.control_process`, started by `ArmSession`.

The process imports neither lerobot nor torch, runs in a separate session out of reach of Ctrl-C, and lands its arms
after SIGTERM or when its parent has exited.
"""

import contextlib
import gc
import logging
import os
import sys
from collections.abc import Callable, Sequence

import can

from lerobot_robot_yam.arm.config import passive_of
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.preflight.arm_inspection import refuse_stopped
from lerobot_robot_yam.control.preflight.open_bus import close_bus, open_bus
from lerobot_robot_yam.control.process import stand_by
from lerobot_robot_yam.control.process.caller import Caller
from lerobot_robot_yam.control.process.robot_loop import build
from lerobot_robot_yam.control.teleop import passive_loop
from lerobot_robot_yam.mobile.robot_parts import Part, part_of
from lerobot_robot_yam.state.base_records import map_blocks
from lerobot_robot_yam.state.desk_post import forget_the_dead
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.records import BlockPair, Descriptors, lock_path
from lerobot_robot_yam.system.log_thread import log_from_a_thread
from lerobot_robot_yam.system.realtime import avoid_oom_killer, request_realtime
from lerobot_robot_yam.system.runtime_files import FileLock, runtime_dir

logger = logging.getLogger("lerobot_robot_yam.control.process.control_process")

RT_PRIORITY = 20
_PARENT_LOOK_S = 0.02


def control(
    parts: Sequence[Part],
    keys: list[str],
    pairs: Sequence[BlockPair],
    on_ready: Callable[[str], None],
    must_land: Callable[[], bool],
    realtime: bool,
) -> None:
    """Run a robot's arms from start to end: lock, open, inspect, energise, run, land, release.

    Raises:
        YamError: bring-up failed; no arm is energised and all locks and buses are released.
    """
    configs = [part.config for part in parts]
    buses: list[can.BusABC] = []
    with contextlib.ExitStack() as ends:  # closes in reverse order
        for pair in pairs:
            ends.callback(pair.close)
        refuse_stopped(configs[0].name, EmergencyStop())  # before a locked channel is reported
        for config, key in zip(configs, keys, strict=True):
            lock = FileLock(lock_path(key), f"CAN channel {config.channel}")
            lock.acquire()
            ends.callback(lock.release)
        for config in configs:
            buses.append(open_bus(config))
            ends.callback(close_bus, buses[-1])
        passive = passive_of(configs[0]) is not None
        if not passive:
            loop = build(parts, keys, buses, pairs)
            ends.callback(loop.close, stand_by=realtime)
        if realtime:
            names, granted = ", ".join(c.name for c in configs), request_realtime(RT_PRIORITY)
            logger.info("control loop of %s: %s, %s", names, granted, avoid_oom_killer())
            gc.disable()
        if passive:
            arms = [part for part in parts if isinstance(part, ResolvedArm)]
            passive_loop.run(arms, buses, keys, pairs, on_ready, must_land)
            return
        loop.start()
        loop.run(on_ready, must_land)


def main() -> int:
    """Run the process; return the exit status."""
    caller = Caller()
    job = caller.job
    with caller.hears_of_errors("control process"):  # a file may have changed since the caller resolved the parts
        parts = [part_of(*part) for part in job["parts"]]
    blocks = zip(parts, job["blocks"], strict=True)
    keys, pairs = job["keys"], [map_blocks(part, Descriptors(*descriptors)) for part, descriptors in blocks]
    passive = passive_of(parts[0].config) is not None  # passive leaders need no landing
    stand_by_pid = 0 if passive else stand_by.spawn(parts, keys, pairs, RT_PRIORITY)
    caller.watch(_PARENT_LOOK_S)

    def watch_stand_by() -> None:
        nonlocal stand_by_pid
        try:
            ended = bool(stand_by_pid) and os.waitpid(stand_by_pid, os.WNOHANG)[0] != 0
        except ChildProcessError:  # SIGCHLD is ignored, as in our parent: the kernel keeps no ended children
            ended = True
        if ended:
            stand_by_pid = 0
            logger.warning("the stand-by has died: should this process be killed, the arms will fall; connect again")

    def must_land() -> bool:
        watch_stand_by()
        return caller.wants_an_end()

    def tell(failure: str) -> None:
        caller.answer(**({"error": failure, "kind": "MotorError"} if failure else {"ready": True}))

    with log_from_a_thread(), caller.hears_of_errors("control process"):
        try:
            control(parts, keys, pairs, tell, must_land, realtime=True)
        finally:
            forget_the_dead(runtime_dir())  # removes files of killed callers
    return 0


if __name__ == "__main__":
    sys.exit(main())
