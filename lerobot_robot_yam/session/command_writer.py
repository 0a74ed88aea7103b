"""What a caller tells the control loop: targets and requests, written into a command block."""

import math
import os
import threading
from collections.abc import Mapping, Sequence

import numpy as np

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.state.records import COMMAND_DTYPE, Request, packed
from lerobot_robot_yam.system.shared_block import SharedBlock

_GRIPPER_OPTIONS = {"dq": 0.0, "kp": math.nan, "kd": math.nan}  # it has its own


class CommandWriter:
    """The command block of the arm called `name`. Any thread may write: who re-arms is often not who streams.

    A forked child may not: it repeats what its parent has taken back since.

    `motors`: of the arm, its gripper's with them.
    """

    def __init__(self, name: str, motors: int):
        self._name, self._pid = name, os.getpid()
        self._lock = threading.Lock()
        self._block = SharedBlock(None, COMMAND_DTYPE, create=True)
        self._pack = packed(COMMAND_DTYPE, motors)[0].pack
        self._unset = [math.nan] * motors
        self._stamp_s, self._number, self._target = 0.0, 0, self._unset
        self._options = [self._unset] * len(_GRIPPER_OPTIONS)
        self._asked, self._requests = Request.NONE, 0
        self._write()

    @property
    def descriptor(self) -> int:
        """Of the block's memory."""
        return self._block.descriptor

    def close(self) -> None:
        """Let go of the block."""
        self._block.close()

    def aim(self, stamp_s: float, target: Sequence[float], options: Mapping[str, np.ndarray]) -> None:
        """Write a target given at `stamp_s` (the clock's time).

        Args:
            target: joints in rad; behind them the gripper, 0 closed … 1 open, where there is one.
            options: dq (rad/s), kp (Nm/rad), kd (Nm s/rad) of the joints, those that are given.

        Raises:
            LifeCycleError: the arm is another process's.
        """
        rows = [
            [*options[field].tolist(), last][: len(target)] if field in options else self._unset
            for field, last in _GRIPPER_OPTIONS.items()
        ]
        self._check_process()
        with self._lock:
            self._target, self._options = list(target), rows
            self._stamp_s = stamp_s
            self._number += 1
            self._write()

    def request(self, request: Request) -> int:
        """Write a request, and return its number; a target the loop has not looked at yet is void.

        Raises:
            LifeCycleError: the arm is another process's.
        """
        self._check_process()
        with self._lock:
            self._asked = request
            self._requests += 1
            self._stamp_s = -math.inf
            self._write()
            return self._requests

    def _check_process(self) -> None:
        if os.getpid() != self._pid:
            raise LifeCycleError(
                f"{self._name}: the arm belongs to process {self._pid}; its forked child {os.getpid()} may watch it, "
                "but not drive it"
            )

    def _write(self) -> None:
        values = [self._stamp_s, self._number, *self._target, *(value for row in self._options for value in row)]
        self._block.write_bytes(self._pack(*values, self._asked, self._requests))
