"""Small healthy data sets of two arms, written by LeRobot itself, and edits that make a copy sick."""

import json

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.face.datasets.check.dataset_report import check_dataset
from tests.support.wrecks import CODER, fingerprint

FPS, FRAMES, EPISODES, SIZE = 20, 60, 3, (48, 64)
SIDES = ("left_", "right_")
CAMERAS = ("top", "left_wrist", "right_wrist")
SICK = 1  # the episode with the defect
ROWS = slice(SICK * FRAMES, (SICK + 1) * FRAMES)
STATE = "observation.state"
BENT = np.array([0.3, 1.2, 1.1, -0.5, 0.2, 0.3])
SPREAD = {"left_": 0.0, "right_": 0.4}  # the arms stand differently
LEFT, RIGHT = slice(0, 7), slice(7, 14)
LAG = 2  # frames that a follower is behind


def names(sides=SIDES):
    return [f"{side}{motor}.pos" for side in sides for motor in (*(f"joint_{i}" for i in range(1, 7)), "gripper")]


JOINTS = [i for i, name in enumerate(names()) if "joint" in name]


def motion(episode, sides=SIDES, frames=FRAMES):
    """(action, state), (frames, 7 per side): a smooth way and a follower that lags, with the noise of a sensor."""
    times = (np.arange(frames + LAG) - LAG) / FPS
    columns = []
    for side in sides:
        phase = 0.7 * episode + 2.0 * SPREAD[side]
        swings = np.sin(2.0 * times[:, None] + phase + 0.4 * np.arange(6))
        columns += [BENT + SPREAD[side] + 0.4 * swings, 0.5 + 0.4 * np.sin(times + phase)[:, None]]
    way = np.concatenate(columns, axis=1)
    noise = np.random.default_rng(episode).normal(scale=5e-4, size=(frames, way.shape[1]))
    return way[LAG:].astype(np.float32), (way[:-LAG] + noise).astype(np.float32)


def picture(camera, state, sides=SIDES):
    """What a camera sees: its own background, and a bright square for each of its arms."""
    random = np.random.default_rng(sum(map(ord, camera)))
    image = np.kron(random.integers(40, 180, (6, 8)), np.ones((8, 8))).astype(np.uint8)
    for place, side in enumerate(sides):
        if camera == "top" or camera.startswith(side):
            x, y = (int(20 + 25 * (value - BENT[i] - SPREAD[side])) for i, value in enumerate(state[7 * place :][:2]))
            image[max(y, 0) + 12 * place :, max(x, 0) :][:10, :12] = 240
    return np.repeat(image[..., None], 3, axis=2)


def write(root, motions, cameras=CAMERAS, robot_type="bi_yam_follower", value_names=None, see=lambda state: state):
    """A data set of these (action, state), one pair per episode; see: what pictures show of a recorded state."""
    value_names = value_names or names()
    numbers = {"dtype": "float32", "shape": (len(value_names),), "names": value_names}
    features = {"action": numbers, "observation.state": numbers}
    for camera in cameras:
        shape = {"dtype": "video", "shape": (*SIZE, 3), "names": ["height", "width", "channels"]}
        features[f"observation.images.{camera}"] = shape
    data = LeRobotDataset.create(
        "local/set",
        FPS,
        features,
        root=root,
        robot_type=robot_type,
        use_videos=bool(cameras),
        streaming_encoding=bool(cameras),
        encoder_queue_maxsize=FRAMES,  # else LeRobot drops frames on a busy machine, and the check finds it
        rgb_encoder=CODER,
    )
    for action, state in motions:
        for given, measured in zip(action, state, strict=True):
            pictures = {f"observation.images.{camera}": picture(camera, see(measured)) for camera in cameras}
            data.add_frame({"action": given, "observation.state": measured, "task": "lift the cube", **pictures})
        data.save_episode()
    data.finalize()
    return root


def edit_rows(root, edit):
    """Let `edit` change the columns, arrays by name, of all rows; it may return other ones."""
    (path,) = (root / "data").rglob("*.parquet")
    table = pq.read_table(path)
    columns = {name: np.array(table.column(name).to_pylist()) for name in table.column_names}
    columns = edit(columns) or columns
    pq.write_table(pa.Table.from_pydict({name: list(v) for name, v in columns.items()}, table.schema), path)


def edit_metadata(root, edit):
    """Let `edit` change the list of LeRobot's rows about episodes."""
    (path,) = (root / "meta" / "episodes").rglob("*.parquet")
    table = pq.read_table(path)
    rows = table.to_pylist()
    edit(rows)
    pq.write_table(pa.Table.from_pylist(rows, table.schema), path)


def edit_json(root, name, edit):
    document = json.loads((root / "meta" / name).read_text())
    edit(document)
    (root / "meta" / name).write_text(json.dumps(document))


def video(root, camera):
    (path,) = (root / "videos" / f"observation.images.{camera}").rglob("*.mp4")
    return path


def repaint(root, camera, paint):
    """Encode a camera's video anew, of paint(episode, frame, image), where None leaves a frame out."""
    path = video(root, camera)
    with av.open(str(path)) as source:
        images = [frame.to_ndarray(format="rgb24") for frame in source.decode(video=0)]
    path.unlink()
    with av.open(str(path), "w") as target:
        stream = target.add_stream("h264", rate=FPS, options={"g": "2", "crf": "10", "preset": "ultrafast"})
        stream.height, stream.width = SIZE
        stream.pix_fmt = "yuv420p"
        for place, image in enumerate(images):
            image = paint(*divmod(place, FRAMES), image)
            if image is not None:
                target.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")))
        target.mux(stream.encode())


def found(root, **options):
    """(kinds of the files' flags, kinds by episode); the data set must be as it was."""
    before = fingerprint(root)
    report = check_dataset(root, **options)
    assert fingerprint(root) == before
    episodes = {episode.number: {flag.kind for flag in episode.flags} for episode in report.episodes if episode.flags}
    return {flag.kind for flag in report.flags}, episodes
