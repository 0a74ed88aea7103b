"""Watching a host: its arms are seen by this computer's programs as its own are, and nothing can be commanded."""

import contextlib
import logging
import threading
from collections.abc import Iterator
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.remote.client.host_question import Host, hello
from lerobot_robot_yam.remote.client.host_rig import ours
from lerobot_robot_yam.remote.client.link import Link
from lerobot_robot_yam.remote.client.state_mirror import MirroredArm, StateMirror
from lerobot_robot_yam.state.records import STATE_DTYPE, lock_path
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock

logger = logging.getLogger(__name__)

_FIELDS = set(ArmConfig.__dataclass_fields__)


@contextlib.contextmanager
def watched(host: Host) -> Iterator[None]:
    """Inside the block the arms that run on the host are in the runtime directory.

    Those that another program of this computer drives over a link are there already.

    Raises:
        YamError: the host does not answer.
    """
    told = hello(host)
    with contextlib.ExitStack() as ends:
        arms, keys = [], {}
        for arm in [arm for group in told["groups"].values() for arm in group["arms"].values()]:
            config = _config(host, arm)
            key = keys[str(arm["key"])] = host.address.key(str(arm["options"]["channel"]))
            lock = FileLock(lock_path(key), f"the link to {config.channel}")
            try:
                lock.acquire()
            except ChannelInUseError:
                continue
            ends.callback(lock.release)
            arms.append(MirroredArm(int(arm["number"]), str(arm["key"]), key, config))
        blocks = [SharedBlock(None, STATE_DTYPE, create=True) for _ in arms]
        mirror = StateMirror(arms, blocks, keys)
        ends.callback(mirror.close)
        link = Link(host, mirror, {}, {})
        ends.callback(link.close)
        ended = threading.Event()

        def turn() -> None:
            while not ended.is_set():
                link.turn()

        thread = threading.Thread(target=turn, name="yam-host-watch", daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


def _config(host: Host, arm: dict[str, Any]) -> ArmConfig:
    options = ours(host.address, arm["options"])
    return ArmConfig(**{name: value for name, value in options.items() if name in _FIELDS})
