"""Some frames that nobody keeps, before the first episode: it begins with cameras, encoders and arms at work.

The first frames of a recording cost most: encoders open and load their last modules, and all processes find their pace.
"""

import logging
import tempfile
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from lerobot.utils.constants import OBS_IMAGES

from lerobot_robot_yam.face.lerobot_command.running_command import Situation, recording

if TYPE_CHECKING:  # the command has loaded it, other commands need not
    from lerobot.datasets.video_utils import StreamingVideoEncoder

logger = logging.getLogger(__name__)

_PUNCTUAL = 10  # frames in a row that came in time: all is at work
_LATE = 1.5  # of a frame's time
_LONGEST_S = 3.0  # wait for punctual frames, s: a machine that is too slow then is so in the episode, too


def rehearse(frame: FrameType | None, step: Callable[[], Mapping[str, Any]]) -> None:
    """Do what a recording does, until frames come in time. Does nothing under other commands.

    Args:
        frame: that of the robot's `connect`.
        step: observes and moves the robot once; returns the images by name. Its errors are passed on.
    """
    command = recording(frame)
    if command is None:
        return
    with tempfile.TemporaryDirectory() as directory:
        encoder = _encoder(command, Path(directory))
        try:
            in_time = _run(1.0 / command.dataset.fps, step, encoder, set(command.dataset.meta.video_keys))
            if encoder is not None:
                encoder.finish_episode()
        finally:
            if encoder is not None:
                encoder.cancel_episode()
    if not in_time:
        what = "this machine is too busy: end other programs, or record fewer or smaller images"
        logger.warning("frames still come late after %.0f s; the recording begins all the same; %s", _LONGEST_S, what)


def _run(period_s: float, step: Callable[[], Mapping[str, Any]], encoder: Any, videos: Collection[str]) -> bool:
    """Whether frames came in time in the end."""
    begin_s = before_s = time.perf_counter()
    punctual = 0
    while before_s - begin_s < _LONGEST_S:
        for name, image in step().items():
            if encoder is not None and (key := f"{OBS_IMAGES}.{name}") in videos:
                encoder.feed_frame(key, image)
        time.sleep(max(before_s + period_s - time.perf_counter(), 0.0))
        now_s = time.perf_counter()
        punctual = punctual + 1 if now_s - before_s < _LATE * period_s else 0
        before_s = now_s
        if punctual == _PUNCTUAL:
            return True
    return False


def _encoder(command: Situation, directory: Path) -> "StreamingVideoEncoder | None":
    """One as the recording's own, at work; None where it encodes afterwards."""
    options, meta = command.config.dataset, command.dataset.meta
    if not options.streaming_encoding or not meta.video_keys:
        return None
    from lerobot.datasets.video_utils import StreamingVideoEncoder

    encoder = StreamingVideoEncoder(
        fps=command.dataset.fps,
        rgb_encoder=options.rgb_encoder,
        depth_encoder=options.depth_encoder,
        queue_maxsize=options.encoder_queue_maxsize,
        encoder_threads=options.encoder_threads,
    )
    encoder.start_episode(list(meta.video_keys), directory, list(meta.depth_keys))
    return encoder
