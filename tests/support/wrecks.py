"""Data sets of LeRobot's own making that were killed in the middle, and what a repaired one has to hold."""

import hashlib
import shutil

import numpy as np
import pyarrow.parquet as pq
from lerobot.configs import RGBEncoderConfig
from lerobot.datasets import LeRobotDataset

FPS, SIZE = 10, (48, 64)
CAMERAS = ("observation.images.top", "observation.images.wrist")
DEPTH = "observation.images.top_depth"
LENGTHS = (12, 9, 15)
TASKS = ("lift the cube", "put it down")
CODER = RGBEncoderConfig(vcodec="h264", preset="ultrafast", crf=10)


def brightness(camera, episode, frame):
    return 20 + 60 * CAMERAS.index(camera) + 15 * episode + 2 * frame


def add_frames(data, episode, count):
    random = np.random.default_rng(episode)
    for frame in range(count):
        vector = random.normal(size=4).astype(np.float32)
        row = {"action": vector, "observation.state": vector + 1, "held": np.array([frame % 3 == 0])}
        row["task"] = TASKS[episode % 2]
        for key in data.meta.camera_keys:
            if key == DEPTH:
                row[key] = np.full((*SIZE, 1), 500 + 100 * episode + frame, np.uint16)
            else:
                row[key] = np.full((*SIZE, 3), brightness(key, episode, frame), np.uint8)
        data.add_frame(row)


def create(root, cameras=CAMERAS, dtype="video", streaming=True, batch=1):
    numbers = {"dtype": "float32", "shape": (4,), "names": list("abcd")}
    features = {
        "action": numbers,
        "observation.state": numbers,
        "held": {"dtype": "bool", "shape": (1,), "names": None},
    }
    for key in cameras:
        shape = (*SIZE, 1 if key == DEPTH else 3)
        features[key] = {"dtype": dtype, "shape": shape, "names": ["height", "width", "channels"]}
        if key == DEPTH:
            features[key]["info"] = {"is_depth_map": True}
    return LeRobotDataset.create(
        "local/wreck",
        FPS,
        features,
        root=root,
        robot_type="bi_yam_follower",
        use_videos=dtype == "video",
        streaming_encoding=streaming,
        batch_encoding_size=batch,
        rgb_encoder=CODER,
    )


def wreck(data, path, lengths=LENGTHS, saved=0):
    """Record episodes, copy the directory in the middle of the next one, finish; episode `saved` is the first."""
    for episode, length in enumerate(lengths, saved):
        add_frames(data, episode, length)
        data.save_episode()
    add_frames(data, saved + len(lengths), 5)
    shutil.copytree(data.root, path)
    data.clear_episode_buffer()
    data.finalize()


def load(root):
    return LeRobotDataset("local/loaded", root=root, video_backend="pyav")


def assert_same(repaired, whole):
    """All rows, pictures and statistics are those of the recording that went on."""
    got, want = load(repaired), load(whole)
    assert got.meta.info.to_dict() == want.meta.info.to_dict()
    assert got.meta.tasks.equals(want.meta.tasks)
    assert got.hf_dataset.data.table.equals(want.hf_dataset.data.table)
    edges = [row[f"dataset_{edge}_index"] for row in want.meta.episodes for edge in ("from", "to")]
    for index in sorted({*edges, *(edge - 1 for edge in edges)} & set(range(len(want)))):
        ours, theirs = got[index], want[index]
        for key in want.meta.camera_keys:
            np.testing.assert_array_equal(ours[key], theirs[key])
    for ours, theirs in zip(episode_rows(repaired), episode_rows(whole), strict=True):
        assert ours.keys() == theirs.keys()
        for name, value in theirs.items():
            key = name.split("/")[1] if name.startswith("stats/") else ""
            if name.startswith("meta/"):  # which metadata file: they are written anew
                continue
            # Ours are of the pictures as they were encoded, and of times as they were stored (float32).
            tolerance = 30.0 if key == DEPTH else 0.03 if key in want.meta.camera_keys else 1e-3
            if name.endswith("/count") or not isinstance(value, float | list) or name == "tasks":
                assert ours[name] == value, name
            else:
                np.testing.assert_allclose(ours[name], value, atol=tolerance, err_msg=name)
    for key, theirs in want.meta.stats.items():
        for name, value in theirs.items():
            np.testing.assert_allclose(got.meta.stats[key][name], value, rtol=1e-6, err_msg=f"{key} {name}")


def episode_rows(root):
    paths = sorted((root / "meta" / "episodes").rglob("*.parquet"))
    return [row for path in paths for row in pq.ParquetFile(path).read().to_pylist()]


def fingerprint(root):
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }
