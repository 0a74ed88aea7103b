"""The link process: `python -m lerobot_robot_yam.remote.client.link_process`, started by `RemoteRunner`.

It stands where the control process stands for arms of this computer: it writes the states of the host's arms into
their blocks, and passes on what the caller commands. It is a process for the same reason: the caller's interpreter
cannot disturb it. It has the host land the arms when it is told to (SIGTERM) or when its parent is gone.

One JSON line on standard input says which arms; one on standard output says "ready" or what went wrong.
"""

import contextlib
import json
import logging
import os
import signal
import sys
from typing import Any

from lerobot_robot_yam.arm.config import LeadArmConfig
from lerobot_robot_yam.control.process.lifeline import ProcessEnd, hung_up
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.remote.client.host_question import Host
from lerobot_robot_yam.remote.client.link import Link
from lerobot_robot_yam.remote.client.state_mirror import MirroredArm, StateMirror
from lerobot_robot_yam.remote.wire.host_address import HostAddress
from lerobot_robot_yam.state.records import BlockPair, Descriptors, lock_path
from lerobot_robot_yam.system.log_thread import log_from_a_thread
from lerobot_robot_yam.system.realtime import raise_threads, request_realtime
from lerobot_robot_yam.system.runtime_files import FileLock

logger = logging.getLogger("lerobot_robot_yam.remote.client.link_process")

RT_PRIORITY = 15  # below that of control loops
_TURNS = 5  # between two looks at the parent, 20 ms
NOT_DOWN = 3  # exit status: the arms are in the air, or nobody knows


def _answer(**fields: object) -> None:
    with contextlib.suppress(OSError):  # the parent is gone, and that is noticed
        sys.stdout.write(json.dumps(fields) + "\n")
        sys.stdout.flush()


def main() -> int:
    """Entry point of the process."""
    logging.basicConfig(
        level=logging.INFO,
        format="%(levelname)s %(asctime)s %(name)s %(message)s",
        datefmt="%Y-%m-%d %H:%M:%S",
    )
    logging.raiseExceptions = False
    for name in (signal.SIGINT, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(name, signal.SIG_IGN)
    stop = False

    def request_stop(*_: object) -> None:
        nonlocal stop
        stop = True

    signal.signal(signal.SIGTERM, request_stop)
    job = json.loads(sys.stdin.readline())
    parent = int(job["parent_pid"])
    try:
        parent_end = ProcessEnd(parent)
    except FileNotFoundError:
        return 1

    def must_stop() -> bool:
        gone = hung_up(job["lifeline"], 0.0) or parent_end.reached() or os.getppid() != parent
        if gone and not stop:
            logger.warning("the process that started this one (%d) is gone: the host lands its arms", parent)
        return stop or gone

    with log_from_a_thread(), contextlib.ExitStack() as ends:
        try:
            link = _link(job, ends)
            link.start(job["group"], job["search"])
        except YamError as error:
            _answer(error=str(error), kind=type(error).__name__)
            return 1
        except Exception as error:
            logger.exception("link failed")
            _answer(error=f"link process failed: {error!r}", kind="YamError")
            return 1
        logger.info("link to %s: %s", job["host"], request_realtime(RT_PRIORITY))
        raise_threads(RT_PRIORITY, "ZMQbg/IO")  # which send and receive
        _answer(ready=True)
        try:
            while not must_stop():
                for _ in range(_TURNS):
                    link.turn()
        finally:
            landed = link.stop(job["group"])
        return 0 if landed else NOT_DOWN


def _link(job: dict[str, Any], ends: contextlib.ExitStack) -> Link:
    """The link that a job describes, whose ends are left to close."""
    pairs = [BlockPair.of(Descriptors(*descriptors)) for descriptors in job["blocks"]]
    arms = []
    for fields, number, host_key, key in zip(job["arms"], job["numbers"], job["host_keys"], job["keys"], strict=True):
        config = LeadArmConfig(**fields)
        lock = FileLock(lock_path(key), f"the link to {config.channel}")
        lock.acquire()
        ends.callback(lock.release)
        arms.append(MirroredArm(number, host_key, key, config))
    for pair in pairs:
        ends.callback(pair.commands.close)
    keys = dict(job["all_keys"])
    mirror = StateMirror(arms, [pair.states for pair in pairs], keys)
    ends.callback(mirror.close)
    commands = {arm.number: pair.commands for arm, pair in zip(arms, pairs, strict=True)}
    host, leaders = Host(HostAddress.of(job["host"]), job["key"]), {here: there for there, here in keys.items()}
    link = Link(host, mirror, commands, leaders, job["lifeline"])
    ends.callback(link.close)
    return link


if __name__ == "__main__":
    sys.exit(main())
