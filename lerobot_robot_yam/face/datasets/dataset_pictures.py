"""Single pictures of a data set's videos, decoded by PyAV: LeRobot does the same, but loads torch for it."""

from pathlib import Path

import av
import numpy as np

from lerobot_robot_yam.errors import DatasetError
from lerobot_robot_yam.face.datasets.check.opened_dataset import OpenedDataset, RecordedEpisode
from lerobot_robot_yam.face.datasets.check.thumbnails import numbered
from lerobot_robot_yam.face.datasets.layout import is_depth


class DatasetPictures:
    """Decodes one frame at a time. The video that was read last of each camera stays open.

    Args:
        data: the data set.
    """

    def __init__(self, data: OpenedDataset):
        self._data = data
        self._videos: dict[str, tuple[Path, av.container.InputContainer]] = {}

    def picture(self, episode: RecordedEpisode, camera: str, frame: int) -> np.ndarray:
        """(height, width, 3) uint8 RGB that a camera saw in a frame of an episode; distances are grey, near is dark.

        Raises:
            DatasetError: there is no such picture, or it cannot be decoded.
        """
        clip = self._data.clip(episode, camera)
        if clip is None or not clip[0].is_file():
            raise DatasetError(f"{camera}: episode {episode.number} has no video")
        try:
            decoded = self._decoded(camera, *clip, frame)
            if is_depth(self._data.features[camera]):
                return _grey(decoded.to_ndarray(format="gray12le"))
            return decoded.to_ndarray(format="rgb24")
        except Exception as error:  # decoders raise anything
            why = str(error).partition("\n")[0][:100]
            raise DatasetError(
                f"{camera}: frame {frame} of episode {episode.number} cannot be decoded: {why}"
            ) from error

    def _decoded(self, camera: str, path: Path, start_s: float, frame: int) -> av.VideoFrame:
        video, stream = self._opened(camera, path)
        assert stream.time_base is not None
        video.seek(round((start_s + (frame + 0.5) / self._data.fps) / stream.time_base), stream=stream)
        for number, picture in numbered(video, stream, start_s, self._data.fps):
            if number == frame:
                return picture
            if number > frame:
                break
        raise EOFError("the video does not have it")

    def _opened(self, camera: str, path: Path) -> tuple[av.container.InputContainer, av.VideoStream]:
        if camera not in self._videos or self._videos[camera][0] != path:
            self._close(camera)
            self._videos[camera] = path, av.open(str(path))
        video = self._videos[camera][1]
        return video, video.streams.video[0]

    def _close(self, camera: str) -> None:
        if camera in self._videos:
            self._videos.pop(camera)[1].close()

    def close(self) -> None:
        """Close the videos. Idempotent."""
        for camera in list(self._videos):
            self._close(camera)


def _grey(distances: np.ndarray) -> np.ndarray:
    low, high = float(distances.min()), float(distances.max())
    shade = ((distances - low) * (255.0 / max(high - low, 1e-9))).astype(np.uint8)
    return np.repeat(shade[..., None], 3, axis=2)
