"""Poses of things in the scene. Each change is a message to every browser, so what stands still sends none."""

import numpy as np
import viser

_UNCHANGED = 2e-4  # m, and parts of a quaternion: below what can be seen, above the noise of an arm that stands


def put(thing: viser.SceneNodeHandle, position_m: np.ndarray, quat_wxyz: np.ndarray) -> None:
    """Put a thing there, (3,) and (4,), in the frame above it, unless it is there."""
    if np.abs(position_m - thing.position).max() > _UNCHANGED:
        thing.position = position_m
    if np.abs(quat_wxyz - thing.wxyz).max() > _UNCHANGED:
        thing.wxyz = quat_wxyz
