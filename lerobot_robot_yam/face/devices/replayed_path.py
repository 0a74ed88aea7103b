"""Replay by odometry: velocities of a recording, corrected so that the base keeps to the recorded poses.

`lerobot-replay` sends the recorded actions alone, which are velocities: what the base misses once, such as after a late
frame, stays missing. The recorded poses are in the observations (option observe_odometry), so they are read from the
data set that the command has opened:

    v = v_recorded + K (p_recorded − p)

with poses p relative to the first one, turned into the body's frame, and the correction limited. The height of a rail
that is driven by velocity is kept likewise.
"""

import numpy as np
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.layout import value_names
from lerobot_robot_yam.face.devices.base_part import HEIGHT, HEIGHT_RATE, ODOMETRY_KEYS
from lerobot_robot_yam.face.lerobot_command.running_command import replayed_dataset
from lerobot_robot_yam.mobile.odometry import to_body, to_world
from lerobot_robot_yam.state.base_records import BaseState

_GAIN = 1.0  # K, 1/s: an error of 0.1 m is met by 0.1 m/s
_MOST = np.array([0.15, 0.15, 0.4])  # maximum correction, m/s, m/s, rad/s: a base that was held does not race back
_MOST_RAIL_M_S = 0.1  # the same of the rail


class ReplayedPath:
    """Poses of one recorded episode.

    Args:
        poses: (n, 3) odometry of each frame, m, m, rad.
        heights: (n,) height of a rail that is driven by velocity, m.
    """

    def __init__(self, poses: np.ndarray, heights: np.ndarray | None = None):
        self._poses, self._heights, self._frame = poses, heights, 0
        self._start: np.ndarray = np.zeros(3)

    def correct(self, values: np.ndarray, state: BaseState) -> np.ndarray:
        """Return the corrected values of the next frame; each call counts one frame.

        Args:
            values: recorded twist (3,) in the body's frame, m/s, m/s, rad/s; or (4,) with the rail's target.
            state: present state.
        """
        pose, frame = state.pose, min(self._frame, len(self._poses) - 1)
        first, recorded = self._poses[0], self._poses[frame]
        if self._frame == 0:
            self._start = pose
        self._frame += 1
        turned = float(self._start[2] - first[2])
        error = self._start + to_world(recorded - first, turned) - pose
        corrected = values.copy()
        corrected[:3] += np.clip(_GAIN * to_body(error, float(pose[2])), -_MOST, _MOST)
        if self._heights is not None and state.rail is not None:
            above_m = float(self._heights[frame]) - state.rail.height_m
            corrected[3] += np.clip(_GAIN * above_m, -_MOST_RAIL_M_S, _MOST_RAIL_M_S)
        return corrected


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
    by_velocity = HEIGHT_RATE in value_names(dataset.features.get(ACTION, {})) and HEIGHT in names
    return ReplayedPath(poses, states[:, names.index(HEIGHT)] if by_velocity else None)
