"""Set-points of arms that another process drives, judged in every state that it publishes: the soak's own check."""

import contextlib
import sys
import threading
import time

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.paths import SCRIPTS


class SetPointWatch:
    """Reads the state blocks of arms, by name of the rig and configuration of each channel, until left.

    Attributes:
        findings: what must not be.
        newest: of each channel, the newest state record; None before the first.
        ratios: of each channel, its fastest set-point in shares of its limit; 0 of one that never moved.
    """

    def __init__(self, rig, configs):
        if str(SCRIPTS) not in sys.path:
            sys.path.insert(0, str(SCRIPTS))
        from soak.checks import SetPointCheck

        self.findings, self.ratios, self.newest = [], {}, {}
        self._checks, self._paths = {}, {}
        for config in configs:
            hardware, limits = ResolvedArm(config), np.full(7, np.nan)
            limits[hardware.slots] = hardware.speed_limit
            self._checks[config.channel] = SetPointCheck(config.channel, limits)
            self.newest[config.channel] = None
            self._paths[config.channel] = state_path(channel_key(config.interface, config.channel, rig))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="set-points")

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        self.ratios = {channel: check.largest_ratio for channel, check in self._checks.items()}

    def _open(self, blocks, channel):
        """Another session has the arm; until it has, the last state of the one before can be read."""
        block = SharedBlock(self._paths[channel], STATE_DTYPE, create=False)
        if channel in blocks:
            blocks[channel].close()
        blocks[channel] = block
        self._checks[channel].forget()

    def _watch(self):
        blocks, seen = {}, dict.fromkeys(self._paths, 0)
        while not self._ended.is_set():
            for channel in self._paths:
                with contextlib.suppress(FileNotFoundError, YamError):
                    if channel not in blocks or not blocks[channel].current:
                        self._open(blocks, channel)
                        seen[channel] = 0
                with contextlib.suppress(KeyError, YamError):
                    sequence = blocks[channel].sequence()
                    record = None if sequence == seen[channel] else blocks[channel].glance()
                    if record is not None:
                        seen[channel], self.newest[channel] = sequence, record
                        self.findings += self._checks[channel].look(record)
            time.sleep(0.002)
        for block in blocks.values():
            block.close()
