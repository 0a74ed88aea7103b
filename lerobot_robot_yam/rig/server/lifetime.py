"""Rig lifetime: a rig ends shortly after its last client leaves, some time after its owner dies, or on request."""

import os
import select
from collections.abc import Callable

from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.rig.client.launch import rig_path
from lerobot_robot_yam.system.runtime_files import FileLock

LINGER_S = 1.0  # time from the last client's disconnect to the end of the rig, s
FIRST_CLIENT_S = 10.0  # time that a rig waits for its first client, s
ORPHAN_S = 30.0  # time from the owner's death to the end of the rig, s: lets clients land their arms


class Lifetime:
    """Decides when the rig ends, under the lock that starters of this rig acquire.

    owner: process id of an unnamed rig's owner, None for a named rig. Times are monotonic, s.
    """

    def __init__(self, name: str, owner: int | None, now_s: float):
        self._lock = FileLock(rig_path(name, "lock"), f"the end of rig {name}")
        self._held_s = now_s  # last time at which a client kept the rig alive
        self._orphaned_s: float | None = None
        self._met = False
        self._told = False
        self._owner_fd = -1
        if owner is not None:
            try:
                self._owner_fd = os.pidfd_open(owner)
            except ProcessLookupError:
                self._orphaned_s = now_s

    def met_a_client(self) -> None:
        """Record the first client: from now on the rig lingers for `LINGER_S` instead of `FIRST_CLIENT_S`."""
        self._met = True

    def end(self) -> None:
        """End the rig, with or without clients, as soon as no process is starting it."""
        self._told = True

    def is_over(self, held: bool, now_s: float, somebody_waits: Callable[[], bool]) -> bool:
        """Return whether to end now. If True, the lock is held, and no process can start this rig until `close`.

        held: whether a client keeps the rig alive. somebody_waits: callback, called under the lock, that returns
        whether a connection is pending, which keeps the rig alive too.
        """
        if self._orphaned_s is None and self._owner_fd >= 0 and select.select([self._owner_fd], [], [], 0)[0]:
            self._orphaned_s = now_s
        if held:
            self._held_s = now_s
        linger = LINGER_S if self._met or self._orphaned_s is not None else FIRST_CLIENT_S
        idle = now_s - self._held_s > linger
        forced = self._told or (self._orphaned_s is not None and now_s - self._orphaned_s > ORPHAN_S)
        if not (idle or forced):
            return False
        try:
            self._lock.acquire()
        except ChannelInUseError:
            return False
        if not forced and somebody_waits():
            self._lock.release()
            return False
        return True

    def close(self) -> None:
        """Release the lock for starters; must be called after the rig's files are removed."""
        if self._owner_fd >= 0:
            os.close(self._owner_fd)
        self._lock.release()
