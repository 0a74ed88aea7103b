"""The check finds each defect that is seeded in rows and metadata, in its episode and nowhere else."""

import json

import numpy as np
import pytest

from lerobot_robot_yam.face.datasets.check.flags import Kind
from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR
from tests.support import seeded_sets as seeds
from tests.support.seeded_sets import (
    EPISODES,
    FPS,
    FRAMES,
    JOINTS,
    LEFT,
    RIGHT,
    ROWS,
    SICK,
    STATE,
    edit_json,
    edit_metadata,
    edit_rows,
    found,
)


def all_of(column, change):
    """A defect: `change` alters this column of the sick episode in place, or returns other values."""

    def seed(root):
        def edit(columns):
            part = columns[column][ROWS].copy()
            changed = change(part)
            columns[column][ROWS] = part if changed is None else changed

        edit_rows(root, edit)

    return seed


def setting(where, value):
    def change(part):
        part[where] = value

    return change


def adding(where, value):
    def change(part):
        part[where] += value

    return change


def drop_rows(root):
    keep = np.r_[0 : ROWS.start + 20, ROWS.start + 24 : EPISODES * FRAMES]
    edit_rows(root, lambda columns: {name: values[keep] for name, values in columns.items()})


def double_rows(root):
    keep = np.r_[0 : ROWS.start + 20, ROWS.start + 18 : EPISODES * FRAMES]
    edit_rows(root, lambda columns: {name: values[keep] for name, values in columns.items()})


def swap_arms(root):
    def edit(columns):
        part = columns["action"][ROWS].copy()
        columns["action"][ROWS, LEFT], columns["action"][ROWS, RIGHT] = part[:, RIGHT], part[:, LEFT]

    edit_rows(root, edit)


def approach(root):
    def edit(columns):
        columns[STATE][ROWS][:20, JOINTS] += np.linspace(0.8, 0, 20)[:, None]

    edit_rows(root, edit)


def freeze_action(root):
    def edit(columns):
        columns["action"][ROWS][20:45] = columns["action"][ROWS][20]

    edit_rows(root, edit)


def side_car(root, **changes):
    for episode in range(EPISODES):
        row = {"episode_index": episode, "times_s": (np.arange(FRAMES) / FPS).tolist(), "repeated_images": {"top": 2}}
        with open(root / SIDE_CAR, "a") as file:
            file.write(json.dumps(row | (changes if episode == SICK else {})) + "\n")


def pause(root):
    times = np.arange(FRAMES) / FPS
    times[30:] += 0.7
    times[30:] -= 0.7 * np.linspace(0, 1, 30)  # the rest came quickly
    side_car(root, times_s=times.tolist())


def shorter_metadata(root):
    edit_metadata(root, lambda rows: rows[SICK].update(length=FRAMES - 5))


def wrong_index(root):
    edit_metadata(root, lambda rows: rows[SICK].update(dataset_from_index=3))


def wrong_statistics(root):
    edit_metadata(root, lambda rows: rows[SICK].update({"stats/action/mean": [9.0] * 14}))


def no_metadata(root):
    edit_metadata(root, lambda rows: rows.pop(SICK))


def no_rows(root):
    keep = np.r_[0 : ROWS.start, ROWS.stop : EPISODES * FRAMES]
    edit_rows(root, lambda columns: {name: values[keep] for name, values in columns.items()})


IN_ROWS = {
    Kind.FRAMES: drop_rows,
    "doubled": double_rows,
    Kind.NO_ROWS: no_rows,
    Kind.NO_METADATA: no_metadata,
    Kind.LENGTH: shorter_metadata,
    Kind.INDEX: wrong_index,
    Kind.TASK: all_of("task_index", setting(30, 7)),
    Kind.NOT_MONOTONE: all_of("timestamp", setting(30, 0.2)),
    Kind.CADENCE: all_of("timestamp", lambda part: part * 1.1),
    Kind.REAL_RATE: lambda root: side_car(root, times_s=(np.arange(FRAMES) / (0.9 * FPS)).tolist()),
    Kind.LATE: pause,
    Kind.CAMERA_SLOW: lambda root: side_car(root, repeated_images={"top": FRAMES // 2}),
    Kind.STATISTICS: wrong_statistics,
    Kind.NOT_FINITE: all_of("action", setting((30, 3), np.nan)),
    "infinite": all_of(STATE, setting((30, 3), np.inf)),
    Kind.UNITS: all_of(STATE, lambda part: np.where(np.isin(range(14), JOINTS), np.degrees(part), part)),
    Kind.JOINT_LIMITS: all_of(STATE, adding((slice(None), 2), 3.3)),
    Kind.GRIPPER_RANGE: all_of("action", adding((slice(20, 30), 6), 0.8)),
    Kind.ACTION_JUMP: all_of("action", adding((slice(30, None), 1), 0.5)),
    Kind.STATE_JUMP: all_of(STATE, adding((slice(30, 32), 3), -0.5)),
    Kind.ACTION_CONSTANT: all_of("action", lambda part: np.repeat(part[:1], FRAMES, axis=0)),
    Kind.ACTION_FROZEN: freeze_action,
    Kind.STATE_FROZEN: all_of(STATE, setting((slice(20, 35), LEFT), seeds.motion(SICK)[1][20, LEFT])),
    Kind.ARMS_SWAPPED: swap_arms,
    Kind.FAR_APART: all_of(STATE, adding((slice(None), 4), 0.5)),
    Kind.APPROACH: approach,
}
ALSO = {  # what else such a defect is, or looks like
    Kind.FRAMES: {Kind.LENGTH, Kind.INDEX},
    "doubled": {Kind.LENGTH, Kind.INDEX, Kind.NOT_MONOTONE},
    Kind.JOINT_LIMITS: {Kind.FAR_APART},
    Kind.ACTION_FROZEN: {Kind.ACTION_JUMP},
    Kind.STATE_FROZEN: {Kind.STATE_JUMP},
    Kind.ACTION_CONSTANT: {Kind.ACTION_FROZEN, Kind.FAR_APART},
}


@pytest.mark.parametrize(("kind", "seed"), IN_ROWS.items(), ids=map(str, IN_ROWS))
def test_a_defect_of_an_episode_is_found_there_and_only_there(kind, seed, data):
    seed(data)
    files, episodes = found(data, every_s=None)
    wanted = {"doubled": Kind.FRAMES, "infinite": Kind.NOT_FINITE}.get(kind, kind)
    assert episodes.keys() == {SICK} and wanted in episodes[SICK]
    assert episodes[SICK] <= {wanted, Kind.STATISTICS} | ALSO.get(kind, set())
    assert files <= {Kind.STATISTICS, Kind.COUNTS}


def test_an_episode_that_was_ended_at_once(tmp_path):
    motions = [seeds.motion(0), seeds.motion(1, frames=8)]
    assert found(seeds.write(tmp_path / "data", motions, ()))[1] == {1: {Kind.SHORT}}


def test_radians_in_a_data_set_of_degrees(tmp_path):
    root = seeds.write(tmp_path / "data", [seeds.motion(0)], (), "bi_yam_follower_degrees")
    assert found(root)[1] == {0: {Kind.UNITS}}


def test_the_limits_are_those_of_the_arm_that_is_named(data):
    all_of(STATE, adding((slice(None), 0), 2.5))(data)
    all_of("action", adding((slice(None), 0), 2.5))(data)
    assert Kind.JOINT_LIMITS not in found(data, every_s=None)[1][SICK]
    assert Kind.JOINT_LIMITS in found(data, every_s=None, arm="big_yam")[1][SICK]


# files


def spoil(name):
    def seed(root):
        (path,) = root.rglob(name)
        path.write_bytes(path.read_bytes()[:50])

    return seed


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        (Kind.COUNTS, lambda root: edit_json(root, "info.json", lambda info: info.update(total_frames=1))),
        (Kind.STATISTICS, lambda root: edit_json(root, "stats.json", lambda s: s["action"].update(max=[1.0] * 14))),
        (Kind.UNREADABLE, spoil("stats.json")),
        (Kind.UNREADABLE, spoil("data/*/file-000.parquet")),
        (Kind.UNREADABLE, spoil("episodes/*/file-000.parquet")),
    ],
)
def test_a_defect_of_the_files_is_found(kind, seed, data):
    seed(data)
    assert kind in found(data, every_s=None)[0]
