"""Place and layout of a camera's newest frame, shared by the renderer and its clients."""

from pathlib import Path

import numpy as np

from lerobot_robot_yam.rig.client.launch import rig_path
from lerobot_robot_yam.system.runtime_files import slug

Settings = tuple[str, int, int, int]
"""Camera, width, height (pixels), frames a second."""

MAX_WIDTH, MAX_HEIGHT = 1280, 960
MAX_FPS = 60


def frame_dtype(width: int, height: int) -> np.dtype:
    """Record of one frame: monotonic and simulated time of the state it shows, a counter, the picture (RGB)."""
    return np.dtype([("stamp_s", "f8"), ("sim_s", "f8"), ("number", "u8"), ("rgb", np.uint8, (height, width, 3))])


def frame_path(rig: str, camera: str, width: int, height: int, fps: int) -> Path:
    """File of the block that holds the newest frame; cameras of equal settings share it."""
    return rig_path(rig, f"camera-{slug(camera)}-{width}x{height}-{fps}")
