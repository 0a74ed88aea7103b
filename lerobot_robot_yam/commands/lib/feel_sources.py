"""What a feel report is made of: the states that a running session publishes, or an episode of a data set.

A session is recorded from outside: nothing is written, nothing asked on a bus.
"""

import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.commands.lib.feel_figures import Motion
from lerobot_robot_yam.errors import BusError, ConfigError, StaleStateError
from lerobot_robot_yam.state.records import STATE_DTYPE, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock

_LOOK_S = 0.0005  # an eighth of a tick
_SILENT_S = 0.5
_INFO = Path("meta", "info.json")
_COLUMNS = ("action", "observation.state")
_LEAST_FRAMES = 30


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


def recorded_motion(root: Path, episode: int) -> Motion:
    """One episode of a data set, both arms of a pair of pairs: actions are the leader's, states the follower's.

    Raises:
        ConfigError: no data set, no such episode, or not of joints; says which.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        info = json.loads((root / _INFO).read_text())
        action, state = ([str(name) for name in info["features"][key]["names"]] for key in _COLUMNS)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{root / _INFO} cannot be read; give the directory of a LeRobot data set") from error
    except (KeyError, TypeError) as error:
        wanted = " and ".join(_COLUMNS)
        raise ConfigError(f"{root}: it has no columns {wanted} with named values, as lerobot-record makes") from error
    joints = [name for name in action if "joint_" in name and name in state]
    if not joints:
        raise ConfigError(f"{root}: its actions are no joints of its states; record it with action_space: joint")
    columns: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
    for path in sorted(root.glob("data/*/*.parquet")):
        try:
            table = pq.read_table(path, columns=list(_COLUMNS), filters=[("episode_index", "==", episode)])
        except (OSError, pa.ArrowException) as error:
            raise ConfigError(f"{path} cannot be read ({error}); repair the data set (yam-repair-dataset)") from error
        for name in _COLUMNS:
            columns[name] += table[name].to_pylist()
    count = len(columns["action"])
    if count < _LEAST_FRAMES:
        has = f"{count} frames" if count else f"no such episode; there are {info.get('total_episodes')}"
        raise ConfigError(f"{root}: episode {episode} has {has}; give --episode another number")
    unit = math.pi / 180.0 if "degrees" in str(info.get("robot_type", "")) else 1.0
    leader, follower = (
        np.array(columns[key])[:, [names.index(joint) for joint in joints]] * unit
        for key, names in zip(_COLUMNS, (action, state), strict=True)
    )
    names = [joint.removesuffix(".pos") for joint in joints]
    return Motion(names, np.arange(count) / float(info["fps"]), leader, follower)
