"""Small grey pictures of an episode, decoded from its video."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import av
import numpy as np

WIDTH, HEIGHT = 64, 48  # a pixel is the mean of about 10 x 10 in a picture of 640 x 480


@dataclass(frozen=True)
class Thumbnails:
    """Pictures of one camera.

    Attributes:
        frames: (k,) numbers of the frames in the episode, growing.
        images: (k, HEIGHT, WIDTH) uint8, grey.
    """

    frames: np.ndarray
    images: np.ndarray


def decode(path: Path, start_s: float, length: int, fps: float, step: int) -> Thumbnails:
    """Pictures of the frames 0 … length - 1 that begin at start_s of a video.

    Args:
        step: 1 for all frames. Else the key frames at or just before every so many frames, and before the last: only
            these are decoded. LeRobot makes every second frame a key frame.

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
            stream.codec_context.thread_count = 1  # more would wait for pictures that nobody wants
        for target in wanted:
            video.seek(round((start_s + (target + 0.5) / fps) / stream.time_base), stream=stream)
            pictures = numbered(video, stream, start_s, fps)
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


def numbered(
    video: av.container.InputContainer, stream: av.VideoStream, start_s: float, fps: float
) -> Iterator[tuple[int, av.VideoFrame]]:
    """Pictures from where the video stands, and which frames of the episode that begins at start_s they are."""
    for picture in video.decode(stream):
        if picture.pts is not None and stream.time_base is not None:
            yield round((float(picture.pts * stream.time_base) - start_s) * fps), picture


def _small(picture: av.VideoFrame) -> np.ndarray:
    return picture.reformat(WIDTH, HEIGHT, "gray", interpolation="AREA").to_ndarray()
