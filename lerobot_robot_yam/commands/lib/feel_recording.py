"""A pair of arms as a data set shows it: the action is the leader, the observed state the follower."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.commands.lib.feel_figures import Motion
from lerobot_robot_yam.errors import ConfigError

_INFO = Path("meta", "info.json")
_COLUMNS = ("action", "observation.state")
_LEAST_FRAMES = 30


def recorded_motion(root: Path, episode: int) -> Motion:
    """The joints of one episode, both arms of a pair of pairs.

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
