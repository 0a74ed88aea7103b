"""What the control loops of two arms publish, recorded from outside: nothing is written, nothing asked on a bus."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from lerobot_robot_yam.errors import BusError, ConfigError, StaleStateError
from lerobot_robot_yam.state.records import STATE_DTYPE, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock

_LOOK_S = 0.0005  # an eighth of a tick
_SILENT_S = 0.5


def record_states(channels: Sequence[tuple[str, str]], seconds: float, begins: Callable[[], None]) -> list[np.ndarray]:
    """The states of some arms while `seconds` pass, records of `STATE_DTYPE` (k,) each.

    Args:
        channels: of each arm what messages call it, and its channel's key.
        seconds: to record.
        begins: called when all arms are there.

    Raises:
        ConfigError: no session drives an arm.
        BusError: a session ended meanwhile.
    """
    blocks: list[SharedBlock] = []
    try:
        for name, key in channels:
            blocks.append(_block(name, key))
        begins()
        payloads: list[list[bytes]] = [[] for _ in blocks]
        seen, until_s = [0] * len(blocks), time.monotonic() + seconds
        while time.monotonic() < until_s:
            for index, block in enumerate(blocks):
                sequence = block.sequence()
                if sequence != seen[index] and (payload := block.glance_bytes()) is not None:
                    seen[index] = sequence
                    payloads[index].append(payload)
            time.sleep(_LOOK_S)
    finally:
        for block in blocks:
            block.close()
    states = [np.frombuffer(b"".join(found), STATE_DTYPE) for found in payloads]
    for (name, _), found in zip(channels, states, strict=True):
        if not len(found) or time.monotonic() - found["stamp_s"][-1] > _SILENT_S:
            raise BusError(f"{name}: its session has ended, or its control loop hangs; start it and measure again")
    return states


def _block(name: str, key: str) -> SharedBlock:
    try:
        return SharedBlock(state_path(key), STATE_DTYPE, create=False)
    except FileNotFoundError as error:
        raise ConfigError(f"{name}: no session drives it; start one, such as lerobot-teleoperate") from error
    except StaleStateError as error:
        raise ConfigError(f"{name}: {error}") from error
