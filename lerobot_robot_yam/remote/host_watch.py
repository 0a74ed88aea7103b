"""Watching a host: programs on this computer see the host's arms like local arms, but cannot command them.

A watched arm has its own key, lock and state. Therefore a program that drives the same arm over a link finds its
channel free. While this computer drives the arm, the watched copy is hidden.
"""

import contextlib
import dataclasses
import logging
import threading
from collections.abc import Iterator
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ChannelInUseError, YamError
from lerobot_robot_yam.mobile.base_config import BASE_PREFIX, BaseConfig
from lerobot_robot_yam.remote.host_question import Host, hello
from lerobot_robot_yam.remote.hosted_device import keys_of
from lerobot_robot_yam.remote.link import Link
from lerobot_robot_yam.remote.mirrored_part import MirroredPart
from lerobot_robot_yam.state.base_records import BASE_STATE_DTYPE
from lerobot_robot_yam.state.records import STATE_DTYPE, lock_path, state_path
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock

logger = logging.getLogger(__name__)

_LOOK_S = 0.2  # interval between checks of which arms this computer drives, s
_AGAIN_S = 5.0  # pause before a retry after an error, s


def watched_key(key: str) -> str:
    """Return the key of the watched copy of the arm with this `key`."""
    return f"{key}.watched"


@contextlib.contextmanager
def watched(host: Host) -> Iterator[None]:
    """Show the host's running arms in the runtime directory while the block runs.

    Arms that another program on this computer drives or watches are already shown.

    Raises:
        YamError: the host does not reply.
    """
    groups = hello(host)["groups"]
    ended = threading.Event()

    def watch() -> None:
        while not ended.is_set():
            try:
                _show(host, groups, ended)
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


def _show(host: Host, groups: dict[str, Any], ended: threading.Event) -> None:
    """Show the arms that no other program on this computer drives or watches, until `ended` is set."""
    keys = keys_of(host, groups)
    configs: dict[int, tuple[str, ArmConfig | BaseConfig]] = {}
    for prefix, part in (row for group in groups.values() for row in group["parts"].items()):
        options, kind = host.address.options(part["options"]), BaseConfig if prefix == BASE_PREFIX else ArmConfig
        fields = {field.name for field in dataclasses.fields(kind)}
        config = kind(**{name: value for name, value in options.items() if name in fields})
        configs[part["number"]] = (keys[part["key"]], config)
    shown: dict[int, MirroredPart] = {}
    look_s = 0.0
    with contextlib.closing(Link(host, shown)) as link:
        try:
            while not ended.is_set():
                if SYSTEM.now() >= look_s:
                    look_s = SYSTEM.now() + _LOOK_S
                    for number, (key, config) in configs.items():
                        _look(shown, number, key, config, keys)
                link.turn()
        finally:
            for mirrored in shown.values():
                mirrored.close()


def _look(
    shown: dict[int, MirroredPart], number: int, key: str, config: ArmConfig | BaseConfig, keys: dict[str, str]
) -> None:
    """Show an arm, or hide it while this computer drives it."""
    if state_path(key).exists():  # not tested by the lock: that could disturb a program that is acquiring the lock
        if number in shown:
            shown.pop(number).close()
    elif number not in shown:
        lock = FileLock(lock_path(watched_key(key)), f"the view of {config.channel}")
        with contextlib.suppress(ChannelInUseError):
            lock.acquire()
            dtype = BASE_STATE_DTYPE if isinstance(config, BaseConfig) else STATE_DTYPE
            states = SharedBlock(None, dtype, create=True)
            shown[number] = MirroredPart(watched_key(key), config, lock, states, None, keys)
