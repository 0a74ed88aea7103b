"""The host's states as this computer's programs read them: in a block per arm, with all times by our clock."""

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.remote.wire.link_messages import ArmNews
from lerobot_robot_yam.state.about import forget_about, tell_about
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, coupling_number, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock

_TIMES = ("stamp_s", "asked_s", "motor_stamp_s", "handle_stamp_s", "action_stamp_s")
_MODES, _GATES = {int(mode) for mode in Mode}, {int(gate) for gate in Gate}


@dataclass(frozen=True)
class MirroredArm:
    """An arm of the host here.

    Attributes:
        number: among all arms of the host.
        host_key, key: of its channel there, and here.
        config: what it is called here.
    """

    number: int
    host_key: str
    key: str
    config: ArmConfig


class StateMirror:
    """Writes the states of some arms.

    Args:
        arms: which.
        blocks: for each, memory to write; published under its key with its first state.
        keys: of all arms of the host, what each key there is here.
    """

    def __init__(self, arms: Sequence[MirroredArm], blocks: Sequence[SharedBlock], keys: Mapping[str, str]):
        self._arms = {arm.number: arm for arm in arms}
        self._blocks = {arm.number: block for arm, block in zip(arms, blocks, strict=True)}
        self._coupled = {0: 0} | {coupling_number(there): coupling_number(here) for there, here in keys.items()}
        self._last: dict[int, np.ndarray] = {}

    @property
    def complete(self) -> bool:
        """Whether each arm has a state."""
        return len(self._last) == len(self._arms)

    def write(self, news: Sequence[ArmNews], ahead_s: float) -> None:
        """Write those of our arms. `ahead_s`: host's clock minus ours. A record that makes no sense is passed over."""
        for number, answered, payload in news:
            block = self._blocks.get(number)
            if block is None:
                continue
            record = np.frombuffer(payload, STATE_DTYPE, count=1).copy()[0]
            if record["mode"] not in _MODES or record["gate"] not in _GATES or record["motors"] < record["joints"]:
                continue
            for field in _TIMES:
                record[field] -= ahead_s
            record["owner_pid"] = os.getpid()
            record["request_sequence"] = answered
            record["coupled_to"] = self._coupled.get(int(record["coupled_to"]), 0)
            block.write(record)
            if number not in self._last:
                self._publish(number)
            self._last[number] = record

    def _publish(self, number: int) -> None:
        arm = self._arms[number]
        with contextlib.suppress(OSError, YamError):  # no other program can watch it
            self._blocks[number].publish(state_path(arm.key))
        tell_about(arm.key, arm.config)

    def note_landed(self) -> None:
        """The host has said that all arms are down: the last state may have got lost."""
        for number, record in self._last.items():
            if record["mode"] != Mode.OFF:
                record["mode"] = Mode.OFF
                self._blocks[number].write(record)

    def close(self) -> None:
        """Hide them, and let go of the memory."""
        for number, arm in self._arms.items():
            self._blocks[number].close()
            forget_about(arm.key)
