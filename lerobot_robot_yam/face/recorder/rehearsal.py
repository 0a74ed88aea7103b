"""Rehearsal of some frames before the first episode, so that cameras, encoders and arms are warmed up at its start.

The first frames of a recording take longest: encoders open and load modules, and all processes have to warm up.
"""

import logging
import tempfile
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot.utils.constants import OBS_IMAGES

from lerobot_robot_yam.face.lerobot_command.running_command import Situation, recording

if TYPE_CHECKING:  # loaded by lerobot-record, and not needed by other commands
    from lerobot.datasets.video_utils import StreamingVideoEncoder

logger = logging.getLogger(__name__)

_PUNCTUAL = 10  # number of consecutive punctual frames that ends the rehearsal
_LATE = 1.5  # number of periods after which a frame counts as late
_LONGEST_S = 3.0  # maximum duration of the rehearsal, s: a machine that is still too slow then stays too slow


def rehearse(step: Callable[[], Mapping[str, Any]]) -> None:
    """Run the steps of a recording until frames come in time. Does nothing under other commands.

    step: function that observes and moves the robot once, and returns name → image. Its errors are passed on.
    """
    command = recording()
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
    """Run until enough frames came in time, or for `_LONGEST_S`. Return whether they came in time."""
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
    """Start an encoder like the recording's own; None if the recording encodes afterwards."""
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
