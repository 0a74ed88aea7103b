"""Pictures from a data set's videos, decoded by PyAV: single pictures, or an episode's pictures as grey thumbnails.

LeRobot can decode videos, too, but loads torch for that.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import av
import numpy as np

from lerobot_robot_yam.errors import DatasetError
from lerobot_robot_yam.face.datasets.check.opened_dataset import OpenedDataset, RecordedEpisode
from lerobot_robot_yam.face.datasets.layout import is_depth

WIDTH, HEIGHT = 64, 48  # size of a thumbnail, pixels; each is the mean of 10 x 10 pixels of a 640 x 480 picture


class DatasetPictures:
    """Decoder of single frames of a data set. Keeps the last video of each camera open."""

    def __init__(self, data: OpenedDataset):
        self._data = data
        self._videos: dict[str, tuple[Path, av.container.InputContainer]] = {}

    def picture(self, episode: RecordedEpisode, camera: str, frame: int) -> np.ndarray:
        """Return a camera's picture of a frame, (height, width, 3) uint8 RGB. Depth becomes grey, near is dark.

        Raises:
            DatasetError: the picture does not exist or cannot be decoded.
        """
        clip = self._data.clip(episode, camera)
        if clip is None or not clip[0].is_file():
            raise DatasetError(f"{camera}: episode {episode.number} has no video")
        try:
            decoded = self._decoded(camera, *clip, frame)
            if is_depth(self._data.features[camera]):
                return _grey(decoded.to_ndarray(format="gray12le"))
            return decoded.to_ndarray(format="rgb24")
        except Exception as error:  # decoders can raise any exception
            why = str(error).partition("\n")[0][:100]
            raise DatasetError(
                f"{camera}: frame {frame} of episode {episode.number} cannot be decoded: {why}"
            ) from error

    def _decoded(self, camera: str, path: Path, start_s: float, frame: int) -> av.VideoFrame:
        video, stream = self._opened(camera, path)
        for number, picture in _pictures_from(frame, video, stream, start_s, self._data.fps):
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
        for camera in list(self._videos):
            self._close(camera)


def _grey(distances: np.ndarray) -> np.ndarray:
    low, high = float(distances.min()), float(distances.max())
    shade = ((distances - low) * (255.0 / max(high - low, 1e-9))).astype(np.uint8)
    return np.repeat(shade[..., None], 3, axis=2)


@dataclass(frozen=True)
class Thumbnails:
    """Small grey pictures of one camera in an episode.

    frames: (k,) increasing frame numbers in the episode. images: (k, HEIGHT, WIDTH) uint8, grey.
    """

    frames: np.ndarray
    images: np.ndarray


def decode(path: Path, start_s: float, length: int, fps: float, step: int) -> Thumbnails:
    """Decode the frames 0 … length - 1 of an episode that begins at `start_s` in a video.

    Args:
        path, fps: the video file and its frames per second.
        start_s: start of the episode in the video, s.
        length: number of frames in the episode.
        step: distance between the wanted frames. 1 decodes all frames. A larger step decodes only key frames: those at
            or just before each step-th frame and the last frame. LeRobot makes every second frame a key frame.

    Raises:
        av.FFmpegError, OSError, EOFError: the video cannot be decoded.
    """
    with av.open(str(path)) as video:
        if not video.streams.video:
            raise EOFError("there are no pictures in it")
        stream = video.streams.video[0]
        if stream.time_base is None:
            raise EOFError("it has no times")
        found: dict[int, np.ndarray] = {}
        wanted = range(1) if step == 1 else sorted({*range(0, length, step), length - 1})
        if step > 1:
            stream.codec_context.skip_frame = "NONKEY"
            stream.codec_context.thread_count = 1  # more threads would wait for pictures that are not needed
        for target in wanted:
            pictures = _pictures_from(target, video, stream, start_s, fps)
            if step == 1:
                inside = takewhile(lambda one: one[0] < length, pictures)
                found = {frame: _small(picture) for frame, picture in inside if frame >= 0}
            else:
                frame, picture = next(pictures, (-1, None))
                if picture is None:
                    raise EOFError(f"it ends before frame {target} of the episode")
                if 0 <= frame < length and frame not in found:
                    found[frame] = _small(picture)
    frames = sorted(found)
    images = np.stack([found[frame] for frame in frames]) if frames else np.empty((0, HEIGHT, WIDTH), np.uint8)
    return Thumbnails(np.array(frames, int), images)


def _small(picture: av.VideoFrame) -> np.ndarray:
    return picture.reformat(WIDTH, HEIGHT, "gray", interpolation="AREA").to_ndarray()


def _pictures_from(
    frame: int, video: av.container.InputContainer, stream: av.VideoStream, start_s: float, fps: float
) -> Iterator[tuple[int, av.VideoFrame]]:
    """Yield (frame number in the episode, picture) from `frame` or slightly earlier; `start_s`: the episode's start."""
    assert stream.time_base is not None
    video.seek(round((start_s + (frame + 0.5) / fps) / stream.time_base), stream=stream)
    for picture in video.decode(stream):
        if picture.pts is not None:
            yield round((float(picture.pts * stream.time_base) - start_s) * fps), picture
