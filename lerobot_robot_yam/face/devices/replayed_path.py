"""Replay by odometry: velocities of a recording, corrected so that the base keeps to the recorded poses.

`lerobot-replay` sends the recorded actions alone, which are velocities: what the base misses once, such as after a late
frame, stays missing. The recorded poses are in the observations (option observe_odometry), so they are read from the
data set that the command has opened:

    v = v_recorded + K (p_recorded − p)

with poses p relative to the first one, turned into the body's frame, and the correction limited.
"""

import numpy as np
from lerobot.utils.constants import OBS_STATE

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.layout import value_names
from lerobot_robot_yam.face.devices.base_part import ODOMETRY_KEYS
from lerobot_robot_yam.face.lerobot_command.running_command import replayed_dataset
from lerobot_robot_yam.mobile.odometry import to_body, to_world

_GAIN = 1.0  # K, 1/s: an error of 0.1 m is met by 0.1 m/s
_MOST = np.array([0.15, 0.15, 0.4])  # maximum correction, m/s, m/s, rad/s: a base that was held does not race back


class ReplayedPath:
    """Poses of one recorded episode.

    poses: (n, 3) odometry of each frame, m, m, rad.
    """

    def __init__(self, poses: np.ndarray):
        self._poses, self._frame = poses, 0
        self._start: np.ndarray = np.zeros(3)

    def correct(self, twist: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Return the corrected twist (3,) of the next frame; each call counts one frame.

        Args:
            twist: (3,) recorded twist in the body's frame, m/s, m/s, rad/s.
            pose: (3,) present odometry, m, m, rad.
        """
        first, recorded = self._poses[0], self._poses[min(self._frame, len(self._poses) - 1)]
        if self._frame == 0:
            self._start = pose
        self._frame += 1
        turned = float(self._start[2] - first[2])
        error = self._start + to_world(recorded - first, turned) - pose
        return twist + np.clip(_GAIN * to_body(error, float(pose[2])), -_MOST, _MOST)


def replayed_path() -> ReplayedPath | None:
    """Return the path that `lerobot-replay` is about to replay; None under another program.

    Raises:
        ConfigError: the data set was recorded without odometry.
    """
    dataset = replayed_dataset()
    if dataset is None:
        return None
    names = list(value_names(dataset.features.get(OBS_STATE, {})))
    if not set(ODOMETRY_KEYS) <= set(names):
        raise ConfigError(
            f"replay_poses: the observations in {dataset.root} lack {', '.join(ODOMETRY_KEYS)}; record with "
            "observe_odometry: true, or replay by velocity"
        )
    states = np.array(dataset.select_columns(OBS_STATE).with_format("numpy")[:][OBS_STATE], float)
    poses = states[:, [names.index(key) for key in ODOMETRY_KEYS]]
    poses[:, 2] = np.radians(poses[:, 2])
    return ReplayedPath(poses)
