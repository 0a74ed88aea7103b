"""Single pictures of a data set's videos, decoded as LeRobot's data set classes decode them."""

import numpy as np

from lerobot_robot_yam.face.datasets.check.opened_dataset import OpenedDataset, RecordedEpisode
from lerobot_robot_yam.face.datasets.layout import is_depth
from lerobot_robot_yam.face.datasets.repair.dataset_on_disk import DatasetError

_TOLERANCE_FRAMES = 0.5  # a stamp may be off by; LeRobot's own 0.1 ms is for training, where none may be


def picture(data: OpenedDataset, episode: RecordedEpisode, camera: str, frame: int) -> np.ndarray:
    """(height, width, 3) uint8 RGB that a camera saw in a frame of an episode; of distances a grey one, near is dark.

    Raises:
        DatasetError: there is no such picture, or it cannot be decoded.
    """
    from lerobot.datasets.video_utils import decode_video_frames  # seconds to import

    clip = data.clip(episode, camera)
    if clip is None or not clip[0].is_file():
        raise DatasetError(f"{camera}: episode {episode.number} has no video")
    path, start_s = clip
    depth = is_depth(data.features[camera])
    try:
        decoded = decode_video_frames(
            path, [start_s + frame / data.fps], _TOLERANCE_FRAMES / data.fps, return_uint8=True, is_depth=depth
        )
    except Exception as error:  # decoders raise anything
        why = str(error).partition("\n")[0][:100]
        raise DatasetError(f"{camera}: frame {frame} of episode {episode.number} cannot be decoded: {why}") from error
    image: np.ndarray = decoded[0].permute(1, 2, 0).numpy()
    return _grey(image[..., 0]) if depth else image


def _grey(distances: np.ndarray) -> np.ndarray:
    low, high = float(distances.min()), float(distances.max())
    shade = ((distances - low) * (255.0 / max(high - low, 1e-9))).astype(np.uint8)
    return np.repeat(shade[..., None], 3, axis=2)
