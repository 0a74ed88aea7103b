"""Whether an episode's videos can be decoded, and its statistics as LeRobot would have written them."""

from typing import Any

import av
import datasets
import numpy as np
from lerobot.configs import DepthEncoderConfig
from lerobot.datasets.compute_stats import (
    auto_downsample_height_width,
    compute_episode_stats,
    get_feature_stats,
    sample_indices,
)
from lerobot.datasets.depth_utils import dequantize_depth
from lerobot.datasets.video_utils import decode_video_frames

from lerobot_robot_yam.face.datasets.repair.dataset_on_disk import Clip, DatasetError, Episode, Findings

_TOLERANCE_S = 1e-4  # LeRobot's own, between a frame and its time in the video
_BATCH = 16  # frames asked for at once: LeRobot's decoder keeps all that lie between the first and the last


def check(findings: Findings, episode: Episode) -> None:
    """Decode the first and the last frame of each video; where LeRobot's statistics are lost, make them.

    Raises:
        DatasetError: a video cannot be decoded.
    """
    if episode.stats is not None:
        for key, clip in episode.videos.items():
            for index in (0, episode.length - 1):
                _frames(findings, key, clip, [index])
        return
    features, chosen = findings.info.features, sample_indices(episode.length)
    table = findings.read_data(episode.path)[0].slice(episode.start, episode.length)
    numeric = {
        key: np.array(table.column(key).to_pylist(), features[key]["dtype"])
        for key in table.column_names
        if features[key]["dtype"] not in ("image", "string", "language")
    }
    stats = compute_episode_stats(numeric, features)
    pictures = {key: _frames(findings, key, clip, chosen) for key, clip in episode.videos.items()}
    for key in findings.keys("image"):
        cells = table.column(key).take(chosen)
        pictures[key] = _small(np.stack([_channels_first(datasets.Image().decode_example(c.as_py())) for c in cells]))
    for key, images in pictures.items():
        scale = 1.0 if _is_depth(features[key]) else 255.0
        raw = get_feature_stats(images, axis=(0, 2, 3), keepdims=True)
        stats[key] = {name: np.squeeze(value / scale, axis=0) for name, value in raw.items() if name != "count"}
        # LeRobot weighs episodes by this: in pixels where it encoded while recording, else in pictures it looked at.
        in_pixels = key in findings.stats and findings.stats[key]["count"][0] > findings.info.total_frames
        stats[key]["count"] = np.array([episode.length * images[0, 0].size if in_pixels else len(images)])
    episode.stats = stats


def _frames(findings: Findings, key: str, clip: Clip, indices: list[int]) -> np.ndarray:
    """Frames of an episode (n, channels, height, width), made smaller as LeRobot does for its statistics.

    Raises:
        DatasetError: they cannot be decoded.
    """
    info = findings.info.features[key].get("info") or {}
    is_depth, path = _is_depth(findings.info.features[key]), findings.root / findings.video(key, clip)
    found = []
    for first in range(0, len(indices), _BATCH):
        exact = np.array(indices[first : first + _BATCH]) / findings.info.fps
        times = [clip.start_s + time for time in exact.astype(np.float32).tolist()]  # as LeRobot stores and asks them
        try:
            frames = decode_video_frames(path, times, _TOLERANCE_S, "pyav", return_uint8=True, is_depth=is_depth)
        except (av.FFmpegError, OSError, ValueError, RuntimeError, IndexError) as error:
            why = str(error).partition("\n")[0][:120]
            raise DatasetError(f"{path.relative_to(findings.root)} cannot be decoded: {why}") from error
        if is_depth:
            coding = DepthEncoderConfig.from_video_info(info)
            limits = {name: getattr(coding, name) for name in ("depth_min", "depth_max", "shift", "use_log")}
            frames = dequantize_depth(frames, **limits, output_unit=info.get("depth_unit") or "mm")
        found.append(_small(frames.numpy()))
    return np.concatenate(found)


def _is_depth(feature: dict[str, Any]) -> bool:
    return bool((feature.get("info") or {}).get("is_depth_map"))


def _small(images: np.ndarray) -> np.ndarray:
    return np.stack([auto_downsample_height_width(image) for image in images])


def _channels_first(image: Any) -> np.ndarray:
    array = np.asarray(image)
    return array[None] if array.ndim == 2 else array.transpose(2, 0, 1)
