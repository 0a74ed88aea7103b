"""What a caller tells the control loop: targets and requests, written into a command block."""

import math
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.state import COMMAND_DTYPE, Request, command_path, packed
from lerobot_robot_yam.shared_block import SharedBlock

_GRIPPER_OPTIONS = {"dq": 0.0, "kp": math.nan, "kd": math.nan}  # it has its own


def _sweep(key: str) -> None:
    """Remove what callers have left that were killed before their loop had opened it."""
    for path in command_path(key, 0).parent.glob(f"command-{key}.*"):
        if not Path("/proc", path.suffix[1:]).exists():
            path.unlink(missing_ok=True)


class CommandWriter:
    """The command block of one arm; `key` names it. Any thread may write: who re-arms is often not who streams.

    `motors`: of the arm, its gripper's with them.
    """

    def __init__(self, key: str, motors: int):
        _sweep(key)
        self._lock = threading.Lock()
        self._block = SharedBlock(command_path(key, os.getpid()), COMMAND_DTYPE, create=True)
        self._pack = packed(COMMAND_DTYPE, motors)[0].pack
        self._unset = [math.nan] * motors
        self._stamp_s, self._number, self._target = 0.0, 0, self._unset
        self._options = [self._unset] * len(_GRIPPER_OPTIONS)
        self._asked, self._requests = Request.NONE, 0
        self._write()

    def close(self) -> None:
        """Let go of the block."""
        self._block.close()

    def aim(self, stamp_s: float, target: Sequence[float], options: Mapping[str, np.ndarray]) -> None:
        """Write a target given at `stamp_s` (the clock's time).

        Args:
            target: joints in rad; behind them the gripper, 0 closed … 1 open, where there is one.
            options: dq (rad/s), kp (Nm/rad), kd (Nm s/rad) of the joints, those that are given.
        """
        rows = [
            [*options[field].tolist(), last][: len(target)] if field in options else self._unset
            for field, last in _GRIPPER_OPTIONS.items()
        ]
        with self._lock:
            self._target, self._options = list(target), rows
            self._stamp_s = stamp_s
            self._number += 1
            self._write()

    def request(self, request: Request) -> int:
        """Write a request, and return its number; a target the loop has not looked at yet is void."""
        with self._lock:
            self._asked = request
            self._requests += 1
            self._stamp_s = -math.inf
            self._write()
            return self._requests

    def _write(self) -> None:
        values = [self._stamp_s, self._number, *self._target, *(value for row in self._options for value in row)]
        self._block.write_bytes(self._pack(*values, self._asked, self._requests))
