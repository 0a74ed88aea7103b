"""The host's states as this computer's programs read them: in a block per arm, with all times by our clock."""

import contextlib
import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.remote.wire.link_messages import ArmNews
from lerobot_robot_yam.state.about import forget_about, tell_about
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, coupling_number, state_path
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.shared_block import SharedBlock

_AT = {name: STATE_DTYPE.fields[name][1] for name in STATE_DTYPE.names or ()}  # type: ignore[index]
_TIMES_AT = [_AT[name] for name in ("stamp_s", "asked_s", "handle_stamp_s", "action_stamp_s")]
_PUBLISHED_AT = _AT["stamp_s"]
_MOTOR_TIMES_AT, _MOTOR_TIMES = _AT["motor_stamp_s"], struct.Struct(f"<{MAX_MOTORS}d")
_MODE_AT, _GATE_AT, _JOINTS_AT, _MOTORS_AT = (_AT[name] for name in ("mode", "gate", "joints", "motors"))
_OWNER_AT, _ANSWERED_AT, _COUPLED_AT = (_AT[name] for name in ("owner_pid", "request_sequence", "coupled_to"))
_MESSAGE = slice(_AT["message"], _AT["message"] + STATE_DTYPE["message"].itemsize)
_TIME, _NUMBER = struct.Struct("<d"), struct.Struct("<Q")
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
        self._last: dict[int, bytearray] = {}
        self._pid = os.getpid()

    @property
    def complete(self) -> bool:
        """Whether each arm has a state."""
        return len(self._last) == len(self._arms)

    def write(self, news: Sequence[ArmNews], ahead_s: float) -> None:
        """Write those of our arms. `ahead_s`: host's clock minus ours. A record that makes no sense is passed over, and
        none is written as if it had been published later than now: it would be fresh for too long.

        With struct: fields of numpy records take five times as long, 250 times a second.
        """
        for number, answered, payload in news:
            block = self._blocks.get(number)
            if block is None:
                continue
            record = bytearray(payload)
            if (
                record[_MODE_AT] not in _MODES
                or record[_GATE_AT] not in _GATES
                or not record[_JOINTS_AT] <= record[_MOTORS_AT] <= MAX_MOTORS
            ):
                continue
            shift_s = max(ahead_s, _TIME.unpack_from(record, _PUBLISHED_AT)[0] - SYSTEM.now())
            for at in _TIMES_AT:
                _TIME.pack_into(record, at, _TIME.unpack_from(record, at)[0] - shift_s)
            times = _MOTOR_TIMES.unpack_from(record, _MOTOR_TIMES_AT)
            _MOTOR_TIMES.pack_into(record, _MOTOR_TIMES_AT, *[time_s - shift_s for time_s in times])
            coupled = self._coupled.get(_NUMBER.unpack_from(record, _COUPLED_AT)[0], 0)
            _NUMBER.pack_into(record, _COUPLED_AT, coupled)
            _NUMBER.pack_into(record, _OWNER_AT, self._pid)
            _NUMBER.pack_into(record, _ANSWERED_AT, answered)
            block.write_bytes(record)
            if number not in self._last:
                self._publish(number)
            self._last[number] = record

    def _publish(self, number: int) -> None:
        arm = self._arms[number]
        with contextlib.suppress(OSError, YamError):  # no other program can watch it
            self._blocks[number].publish(state_path(arm.key))
        tell_about(arm.key, arm.config)

    def note(self, mode: Mode, message: str = "") -> None:
        """Write a mode of all arms that are not off, and why, that the host's states have not told: those may have got
        lost, or be another client's by now."""
        for number, record in self._last.items():
            if record[_MODE_AT] != Mode.OFF:
                record[_MODE_AT] = mode
                if message:
                    record[_MESSAGE] = message.encode().ljust(_MESSAGE.stop - _MESSAGE.start, b"\0")
                self._blocks[number].write_bytes(record)

    def close(self) -> None:
        """Hide them, and let go of the memory."""
        for number, arm in self._arms.items():
            self._blocks[number].close()
            forget_about(arm.key)
