"""Arms of a host whose rig is in lock-step, driven over the link: the world stands still while messages travel."""

from functools import partial

from lerobot_robot_yam.remote.link import Link
from lerobot_robot_yam.remote.mirrored_part import MirroredPart
from lerobot_robot_yam.state.base_records import map_blocks
from lerobot_robot_yam.state.records import lock_path
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.runtime_files import FileLock

_WITHIN_S = 20.0  # of real time


class LinkInStep:
    """A `Runner` and the caller's clock. Link, sockets and host are the shipped ones; the link runs in this thread.

    Args:
        served: the host, `ServedArms` of a rig in lock-step.
        device, arms, keys: as of `RemoteRunner`.
    """

    def __init__(self, served, device, arms, keys):
        self._group, self._device, self._arms, self._keys = served.groups[0], device, arms, keys
        self._link = None
        self._pairs = []
        self._written = 0

    @classmethod
    def on(cls, served, device):
        """What makes it, as `HostedDevice.runner` does."""
        return partial(cls, served, device)

    @property
    def clock(self):
        return self

    @property
    def _world(self):
        return self._group._session.clock

    def now(self):
        return self._world.now()

    def sleep(self, seconds):
        if self._link is None:
            return
        self._turn_until(lambda: self._group.newest == self._written)
        self._world.sleep(seconds)
        self._turn_until(lambda: self._ticks() == [arm.client.published().tick for arm in self._group.parts])

    def _ticks(self):
        return [int(pair.states.read()["tick"]) for pair in self._pairs]

    def _turn_until(self, condition):
        deadline = SYSTEM.now() + _WITHIN_S
        while not condition():
            self._link.turn()
            if SYSTEM.now() > deadline:
                told = f"{self._written} commands written, ticks {self._ticks()}; there {self._group.newest}"
                raise AssertionError(f"nothing comes over the link: {told}, {self._group.phase}")

    def note_written(self, arm):
        self._written += 1

    def start(self, blocks):
        device = self._device
        pairs = zip(self._arms, blocks, strict=True)
        self._pairs = [map_blocks(part, descriptors.copies()) for part, descriptors in pairs]
        arms = {
            number: MirroredPart(key, arm.config, FileLock(lock_path(key), "a test"), *pair, device.all_keys)
            for number, key, arm, pair in zip(device.numbers, self._keys, self._arms, self._pairs, strict=True)
        }
        self._link = Link(device.host, arms, drives=True)
        self._link.start(device.group, search=True, unwanted=lambda: False)
        # What the blocks begin with is sent, too: a link that was up early would send the first frame's in its place.
        self._turn_until(lambda: self._group.newest == self._written)

    def land(self):
        """`stop` does."""

    def stop(self, off=lambda: True):
        link, self._link = self._link, None
        landed = link.stop(self._device.group)
        link.close()
        for arm in link._arms.values():
            arm.close()
        return landed and off()
