"""Data sets of any size in LeRobot's layout, written without LeRobot: rows at once, and one video for all episodes."""

import json
import os
from fractions import Fraction

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.support import seeded_sets as seeds

STATISTICS = {"min": np.min, "max": np.max, "mean": np.mean}


def write(root, episodes, frames, fps=30, cameras=seeds.CAMERAS, size=(480, 640), coder=None, robot="bi_yam_follower"):
    """A healthy data set of two arms.

    Args:
        size: of the pictures; height and width are multiples of 48 and 64.
        coder: of PyAV, with its options.
    """
    names = seeds.names()
    numbers = {"dtype": "float32", "shape": [len(names)], "names": names}
    features = {"action": numbers, seeds.STATE: numbers}
    keys = [f"observation.images.{camera}" for camera in cameras]
    for key in keys:
        features[key] = {"dtype": "video", "shape": [*size, 3], "names": ["height", "width", "channels"]}
    info = {
        "codebase_version": "v3.0",
        "robot_type": robot,
        "total_episodes": episodes,
        "total_frames": episodes * frames,
        "fps": fps,
        "features": features,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }
    motions = [seeds.motion(episode, frames=frames) for episode in range(episodes)]
    (root / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    (root / "data" / "chunk-000").mkdir(parents=True)
    (root / "meta" / "info.json").write_text(json.dumps(info))
    tasks = pa.table({"task_index": [0], "task": ["lift the cube"]})
    pq.write_table(tasks, root / "meta" / "tasks.parquet")
    whole = {"action": np.concatenate([m[0] for m in motions]), seeds.STATE: np.concatenate([m[1] for m in motions])}
    statistics = {name: {kind: _of(of, values) for kind, of in STATISTICS.items()} for name, values in whole.items()}
    (root / "meta" / "stats.json").write_text(json.dumps(statistics))
    with pq.ParquetWriter(root / "data" / "chunk-000" / "file-000.parquet", _rows(0, motions[0], fps).schema) as file:
        for episode, motion in enumerate(motions):
            file.write_table(_rows(episode, motion, fps))
    described = [_about(episode, motion, keys, fps) for episode, motion in enumerate(motions)]
    pq.write_table(pa.Table.from_pylist(described), root / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    for camera, key in zip(cameras, keys, strict=True):
        folder = root / "videos" / key / "chunk-000"
        folder.mkdir(parents=True)
        _film(folder / "file-000.mp4", camera, motions[0][1], fps, size, coder or ("h264", {"preset": "ultrafast"}))
        for episode in range(1, episodes):
            os.link(folder / "file-000.mp4", folder / f"file-{episode:03d}.mp4")
    return root


def _of(of, values):
    return of(values, axis=0).astype(float).tolist()


def _rows(episode, motion, fps):
    action, state = motion
    frames = len(action)
    return pa.table(
        {
            "action": pa.FixedSizeListArray.from_arrays(pa.array(action.ravel()), action.shape[1]),
            seeds.STATE: pa.FixedSizeListArray.from_arrays(pa.array(state.ravel()), state.shape[1]),
            "timestamp": pa.array((np.arange(frames) / fps).astype(np.float32)),
            "frame_index": np.arange(frames),
            "episode_index": np.full(frames, episode),
            "index": episode * frames + np.arange(frames),
            "task_index": np.zeros(frames, int),
        }
    )


def _about(episode, motion, keys, fps):
    frames = len(motion[0])
    row = {
        "episode_index": episode,
        "tasks": ["lift the cube"],
        "length": frames,
        "dataset_from_index": episode * frames,
        "dataset_to_index": (episode + 1) * frames,
        "data/chunk_index": 0,
        "data/file_index": 0,
    }
    for key in keys:
        places = {"chunk_index": 0, "file_index": episode, "from_timestamp": 0.0, "to_timestamp": frames / fps}
        row |= {f"videos/{key}/{name}": value for name, value in places.items()}
    for name, values in zip(("action", seeds.STATE), motion, strict=True):
        row |= {f"stats/{name}/{kind}": _of(of, values) for kind, of in STATISTICS.items()}
    return row


def _film(path, camera, states, fps, size, coder):
    """A picture per state, with the noise of a sensor; every second one is a key frame, as LeRobot has it."""
    random, scale = np.random.default_rng(0), size[0] // seeds.SIZE[0]
    noise = random.integers(-4, 5, (*size, 1), np.int16)
    with av.open(str(path), "w") as target:
        stream = target.add_stream(coder[0], rate=fps, options={"g": "2", **coder[1]})
        stream.height, stream.width, stream.pix_fmt = *size, "yuv420p"
        stream.time_base = Fraction(1, fps)
        for state in states:
            large = np.kron(seeds.picture(camera, state), np.ones((scale, scale, 1), np.uint8)).astype(np.int16)
            noisy = (large + np.roll(noise, random.integers(size[1]), axis=1)).clip(0, 255).astype(np.uint8)
            target.mux(stream.encode(av.VideoFrame.from_ndarray(noisy, format="rgb24")))
        target.mux(stream.encode())
