"""Watching a host: its arms are seen by this computer's programs as its own are, and nothing can be commanded.

An arm that is watched has a key of its own, with a lock and a state under it. So whoever drives it over a link finds
its channel free, and has a lock and a state beside these. While it is driven it is not shown a second time.
"""

import contextlib
import logging
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ChannelInUseError, YamError
from lerobot_robot_yam.remote.client.host_question import Host, hello
from lerobot_robot_yam.remote.client.link import Link
from lerobot_robot_yam.remote.client.state_mirror import MirroredArm, StateMirror
from lerobot_robot_yam.remote.wire.transport import reaching
from lerobot_robot_yam.state.records import STATE_DTYPE, lock_path, state_path
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock

logger = logging.getLogger(__name__)

_FIELDS = set(ArmConfig.__dataclass_fields__)
_LOOK_S = 0.2  # between looks which arms are driven from here
_AGAIN_S = 5.0  # after an error


@dataclass(frozen=True)
class _Watched:
    """An arm as we show it, the key under which it is driven from here, and our lock: one program shows it."""

    arm: MirroredArm
    driven_as: str
    lock: FileLock

    @classmethod
    def of(cls, host: Host, told: dict[str, Any]) -> "_Watched":
        options = host.address.options(told["options"])
        config = ArmConfig(**{name: value for name, value in options.items() if name in _FIELDS})
        driven_as = host.address.key(str(told["options"]["channel"]))
        key = watched_key(driven_as)
        lock = FileLock(lock_path(key), f"the view of {config.channel}")
        return cls(MirroredArm(int(told["number"]), str(told["key"]), key, config), driven_as, lock)


def watched_key(key: str) -> str:
    """Under which an arm is shown while nobody drives it over a link from here. `key`: under which it is driven."""
    return f"{key}.watched"


@contextlib.contextmanager
def watched(host: Host) -> Iterator[None]:
    """Inside the block the arms that run on the host are in the runtime directory.

    Those that another program of this computer drives over a link, or watches, are there already.

    Raises:
        YamError: the host does not answer.
    """
    arms = [_Watched.of(host, arm) for group in hello(host)["groups"].values() for arm in group["arms"].values()]
    ended = threading.Event()

    def watch() -> None:
        while not ended.is_set():
            try:
                _show(host, arms, ended)
            except (YamError, OSError) as error:
                logger.error("%s is not watched for a moment: %s", host.address, error)
                ended.wait(_AGAIN_S)

    thread = threading.Thread(target=watch, name="yam-host-watch", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        for arm in arms:
            arm.lock.release()


def _show(host: Host, arms: Sequence[_Watched], ended: threading.Event) -> None:
    """Show those that are ours to show, until these are others."""
    shown = _ours_to_show(arms)
    with contextlib.ExitStack() as ends:
        ends.enter_context(reaching(host.address))
        blocks = [SharedBlock(None, STATE_DTYPE, create=True) for _ in shown]
        mirror = StateMirror([each.arm for each in shown], blocks, {each.arm.host_key: each.arm.key for each in arms})
        ends.callback(mirror.close)
        link = Link(host, mirror, {}, {})
        ends.callback(link.close)
        look_s = SYSTEM.now()
        while not ended.is_set():
            link.turn()
            if SYSTEM.now() - look_s > _LOOK_S:
                look_s = SYSTEM.now()
                if _ours_to_show(arms) != shown:
                    return


def _ours_to_show(arms: Sequence[_Watched]) -> list[_Watched]:
    """Those that nobody drives from here, and no other program watches."""
    for each in arms:
        if state_path(each.driven_as).exists():  # not a lock's look: who drives it may be taking that just now
            each.lock.release()
        elif not each.lock.held:
            with contextlib.suppress(ChannelInUseError):
                each.lock.acquire()
    return [each for each in arms if each.lock.held]
