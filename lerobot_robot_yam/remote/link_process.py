"""Link process: `python -m lerobot_robot_yam.remote.link_process`, started by `RemoteRunner`.

The link process replaces the control process: it writes the states of the host's arms into their blocks, and sends the
caller's commands. It is a separate process so that the caller's interpreter cannot disturb it. On SIGTERM, or when its
parent has died, it makes the host land the arms.
"""

import contextlib
import logging
import sys
from typing import Any

from lerobot_robot_yam.control.process.caller import Caller
from lerobot_robot_yam.mobile.robot_parts import part_of
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.link import Link
from lerobot_robot_yam.remote.mirrored_part import MirroredPart
from lerobot_robot_yam.state.base_records import map_blocks
from lerobot_robot_yam.state.records import Descriptors, lock_path
from lerobot_robot_yam.system.log_thread import log_from_a_thread
from lerobot_robot_yam.system.realtime import raise_threads, request_realtime
from lerobot_robot_yam.system.runtime_files import FileLock

logger = logging.getLogger("lerobot_robot_yam.remote.link_process")

RT_PRIORITY = 15  # real-time priority, below that of control loops
_PARENT_LOOK_S = 0.1  # interval between checks that the parent is alive, s
NOT_DOWN = 3  # exit status if the arms may still be in the air


def main() -> int:
    caller = Caller()
    job = caller.job
    caller.watch(_PARENT_LOOK_S)
    with log_from_a_thread(), contextlib.ExitStack() as ends:
        with caller.hears_of_errors("link process"):
            link = _link(job, ends)
            link.start(job["group"], job["search"], caller.wants_an_end)
        logger.info("link to %s: %s", job["host"], request_realtime(RT_PRIORITY))
        raise_threads(RT_PRIORITY, "ZMQbg/IO")  # ZeroMQ's threads that send and receive
        caller.answer(ready=True)
        try:
            while not caller.wants_an_end():
                link.turn()
        finally:
            landed = link.stop(job["group"])
        return 0 if landed else NOT_DOWN


def _link(job: dict[str, Any], ends: contextlib.ExitStack) -> Link:
    """Create the link that a job describes; `ends` closes the link."""
    parts = {}
    rows = zip(job["parts"], job["numbers"], job["keys"], job["blocks"], strict=True)
    for plain, number, key, descriptors in rows:
        part = part_of(*plain)
        lock = FileLock(lock_path(key), f"the link to {part.config.channel}")
        lock.acquire()
        pair = map_blocks(part, Descriptors(*descriptors))
        parts[number] = MirroredPart(key, part.config, lock, *pair, job["all_keys"])
        ends.callback(parts[number].close)
    link = Link(Host(HostAddress.of(job["host"]), job["key"]), parts, drives=True, nudged=job["lifeline"])
    ends.callback(link.close)
    return link


if __name__ == "__main__":
    sys.exit(main())
