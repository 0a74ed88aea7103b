"""Host's arm or base as seen by programs on this computer: its states in a local block, with local times."""

import contextlib
import os
from collections.abc import Mapping

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.state.about import forget_about, tell_about
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE, coupling_number, state_path
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock

_TIMES = ("stamp_s", "asked_s", "until_s")  # ends of the names of fields that are times of the clock


def times_in(dtype: np.dtype) -> list[str]:
    """Return the names of the fields of a record that are times of the clock."""
    return [name for name in dtype.names or () if name.endswith(_TIMES)]


class MirroredPart:
    """Local mirror of a host's arm or base. Other programs find its states after the first state has arrived.

    Args:
        key: key of the channel on this computer.
        config: config on this computer.
        lock: lock of the channel, already acquired.
        states: shared memory for the host's states.
        commands: shared memory with the caller's commands; None if the part is only watched.
        keys: for every part of the host: channel key on the host → channel key on this computer.
    """

    def __init__(
        self,
        key: str,
        config: ArmConfig | BaseConfig,
        lock: FileLock,
        states: SharedBlock,
        commands: SharedBlock | None,
        keys: Mapping[str, str],
    ):
        self._key, self._config, self._lock, self._states, self._commands = key, config, lock, states, commands
        self._coupled = {coupling_number(there): coupling_number(here) for there, here in keys.items()}
        self._leaders = {here.encode(): there.encode() for there, here in keys.items()}
        self._state_times = times_in(states.dtype)
        self._command_times = [] if commands is None else times_in(commands.dtype)
        self._last: np.ndarray | None = None
        self._sent = 0  # sequence number of the last forwarded command record

    @property
    def known(self) -> bool:
        """Whether the part has a state."""
        return self._last is not None

    def write(self, record: bytes, ahead_s: float) -> None:
        """Write a state from the host. A publication time in the future is shifted to the current time.

        A later publication time would make the state count as fresh for too long.

        Args:
            record: first bytes of a state record, host's clock; the missing rest is zeros.
            ahead_s: host's clock minus the local clock, s.
        """
        dtype = self._states.dtype
        state = np.frombuffer(bytearray(record.ljust(dtype.itemsize, b"\0")), dtype).reshape(())
        shift_s = max(ahead_s, float(state["stamp_s"]) - SYSTEM.now())
        for name in self._state_times:
            state[name] -= shift_s
        if dtype == STATE_DTYPE:
            state["coupled_to"] = self._coupled.get(int(state["coupled_to"]), 0)
        state["owner_pid"] = os.getpid()
        self._states.write(state)
        if self._last is None:
            with contextlib.suppress(OSError, YamError):  # without the file no other program can watch the part
                self._states.publish(state_path(self._key))
            tell_about(self._key, self._config)
        self._last = state

    def note(self, mode: Mode, message: str = "") -> None:
        """Write mode and reason, unless the part is off. Used when the host's states are lost or another client's."""
        if self._last is not None and self._last["mode"] != Mode.OFF:
            self._last["mode"], self._last["message"] = mode, message.encode() or self._last["message"]
            self._states.write(self._last)

    def command(self, ahead_s: float) -> bytes | None:
        """Return the caller's new command record; None if there is none since the last call, or during a write.

        Args:
            ahead_s: host's clock minus the local clock, s. Times in the returned record are in the host's clock.
        """
        if self._commands is None or self._commands.sequence() == self._sent:
            return None
        sequence, record = self._commands.sequence(), self._commands.glance()
        if record is None:
            return None
        self._sent = sequence
        for name in self._command_times:
            record[name] += ahead_s
        if self._commands.dtype == COMMAND_DTYPE:
            record["leader"] = self._leaders.get(record["leader"].item(), b"")
        return record.tobytes()

    def close(self) -> None:
        """Remove the part's files, and release its memory and lock. Idempotent."""
        self._states.close()
        if self._commands is not None:
            self._commands.close()
        forget_about(self._key)
        self._lock.release()
