"""yam-dataset-check finds each seeded defect, and nothing in healthy data sets."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.commands.data.dataset_check import main
from lerobot_robot_yam.face.datasets.check.dataset_report import check_dataset
from lerobot_robot_yam.face.datasets.check.flags import Kind
from lerobot_robot_yam.face.recorder.episode_log import SIDE_CAR
from tests.support import seeded_sets as seeds
from tests.support.seeded_sets import EPISODES, FPS, FRAMES, edit_json, edit_metadata, edit_rows, repaint
from tests.support.wrecks import fingerprint

SICK = 1  # the episode with the defect
ROWS = slice(SICK * FRAMES, (SICK + 1) * FRAMES)
STATE = "observation.state"
JOINTS = [i for i, name in enumerate(seeds.names()) if "joint" in name]
LEFT, RIGHT = slice(0, 7), slice(7, 14)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A healthy data set."""
    motions = [seeds.motion(episode) for episode in range(EPISODES)]
    return seeds.write(tmp_path_factory.mktemp("check") / "whole", motions)


@pytest.fixture
def data(whole, tmp_path):
    """A copy to damage."""
    shutil.copytree(whole, tmp_path / "data")
    return tmp_path / "data"


def found(root, **options):
    """(kinds of the files' flags, kinds by episode); the data set must be as it was."""
    before = fingerprint(root)
    report = check_dataset(root, **options)
    assert fingerprint(root) == before
    episodes = {episode.number: {flag.kind for flag in episode.flags} for episode in report.episodes if episode.flags}
    return {flag.kind for flag in report.flags}, episodes


# healthy


def resting(motions):
    """The right arm stays where it is to the last bit, its gripper too."""
    for action, state in motions:
        action[:, RIGHT] = state[:, RIGHT] = state[0, RIGHT]


def pausing(motions):
    """The leaders stop for a second; the followers come after."""
    for action, state in motions:
        action[20:40], state[22:40] = action[20], action[20]
        action[40:], state[40:] = action[20:40], action[20:40]


def waiting(motions):
    """For a second and a half nothing moves at all, as on the virtual rig; then the leaders are quick."""
    for action, state in motions:
        quick = 0.1 * np.maximum(np.arange(FRAMES) - 30, 0)[:, None]
        action[:], state[:] = action[0], action[0]
        action[:, JOINTS] += 0.6 * np.sin(quick + 0.3) - 0.6 * np.sin(0.3)
        state[:, JOINTS] = action[np.maximum(np.arange(FRAMES) - 2, 0)][:, JOINTS]


@pytest.mark.parametrize("habit", [None, resting, pausing, waiting])
def test_nothing_is_found_in_a_healthy_data_set(habit, tmp_path):
    motions = [seeds.motion(episode) for episode in range(2)]
    if habit:
        habit(motions)
    root = seeds.write(tmp_path / "data", motions, ("top", "right_wrist"))
    assert found(root, every_s=0) == found(root) == (set(), {})


def test_nothing_is_found_in_healthy_degrees(tmp_path):
    motions = [seeds.motion(episode, ("left_",)) for episode in range(EPISODES)]
    for values in (values for pair in motions for values in pair):
        values[:, :6] = np.degrees(values[:, :6])
        values[:, 6] = 0.3  # the gripper is not used
    names = [name.removeprefix("left_") for name in seeds.names(("left_",))]
    root = seeds.write(tmp_path / "data", motions, (), "yam_follower_degrees", names)
    assert found(root) == (set(), {})


def test_of_other_robots_only_what_their_names_tell_is_judged(tmp_path):
    values = 100 * np.random.default_rng(0).normal(size=(FRAMES, 2)).astype(np.float32)
    root = seeds.write(tmp_path / "data", [(values, values + 30)], (), "so101_follower", ["pan.pos", "gripper.pos"])
    assert found(root) == (set(), {})


# rows


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


# pictures


def during(episode, frames, image):
    """A painter that shows something else in some frames of an episode."""
    return lambda e, f, seen: image(seen) if e == episode and f in frames else seen


def freeze(root, first=10, end=45):
    still = seeds.picture("top", seeds.motion(SICK)[1][10])
    repaint(root, "top", during(SICK, range(first, end), lambda seen: still))


def swap_pictures(root):
    views = {c: [seeds.picture(c, state) for state in seeds.motion(SICK)[1]] for c in ("top", "left_wrist")}
    for one, other in (("top", "left_wrist"), ("left_wrist", "top")):
        repaint(root, one, lambda e, f, seen, other=other: views[other][f] if e == SICK else seen)


def no_clip(root):
    edit_metadata(root, lambda rows: rows[SICK].update({"videos/observation.images.top/file_index": None}))


IN_PICTURES = {
    Kind.CAMERA_FROZEN: freeze,
    Kind.CAMERA_DARK: lambda root: repaint(root, "left_wrist", during(SICK, range(FRAMES), lambda seen: 0 * seen)),
    Kind.CAMERA_BRIGHT: lambda root: repaint(root, "top", during(SICK, range(FRAMES), lambda seen: 0 * seen + 255)),
    Kind.CAMERAS_SWAPPED: swap_pictures,
    Kind.VIDEO_MISSING: no_clip,
}


@pytest.mark.parametrize(("kind", "seed"), IN_PICTURES.items(), ids=map(str, IN_PICTURES))
def test_a_defect_of_pictures_is_found_there_and_only_there(kind, seed, data):
    seed(data)
    files, episodes = found(data)
    assert not files and episodes.keys() == {SICK} and kind in episodes[SICK]
    assert episodes[SICK] <= {kind} | (
        {Kind.CAMERA_FROZEN} if kind in (Kind.CAMERA_DARK, Kind.CAMERA_BRIGHT) else set()
    )


def test_a_short_freeze_and_a_black_picture_are_found_where_all_pictures_are_looked_at(data):
    freeze(data, 10, 22)
    repaint(data, "right_wrist", during(SICK, [33], lambda seen: 0 * seen))
    assert found(data)[1] == {}
    assert found(data, every_s=0)[1] == {SICK: {Kind.CAMERA_FROZEN, Kind.CAMERA_DARK}}


def test_a_camera_at_half_the_rate(data):
    states = [seeds.motion(episode)[1] for episode in range(EPISODES)]
    repaint(data, "top", lambda e, f, seen: seeds.picture("top", states[e][f - f % 2]))
    assert found(data, every_s=0)[1] == {episode: {Kind.CAMERA_SLOW} for episode in range(EPISODES)}


def test_two_cameras_that_are_one(data):
    shutil.copy(seeds.video(data, "top"), seeds.video(data, "left_wrist"))
    assert found(data)[1] == {episode: {Kind.CAMERAS_ALIKE} for episode in range(EPISODES)}


def test_a_video_without_its_last_frames(data):
    repaint(data, "top", lambda e, f, seen: None if e == EPISODES - 1 and f > 50 else seen)
    assert found(data)[1] == {EPISODES - 1: {Kind.VIDEO_SHORT}}


def test_videos_that_are_gone_or_broken(data):
    seeds.video(data, "top").unlink()
    path = seeds.video(data, "left_wrist")
    content = path.read_bytes()
    begin = content.index(b"mdat") + 4
    path.write_bytes(content[:begin] + bytes(len(content) - begin))
    for kinds in (found(data)[1], found(data, every_s=0)[1]):
        assert kinds == {episode: {Kind.VIDEO_MISSING, Kind.VIDEO_BROKEN} for episode in range(EPISODES)}


# the command


def test_what_the_command_says(data, capsys):
    assert main([str(data)]) == 0
    healthy = capsys.readouterr().out.splitlines()
    assert healthy[0] == f"{data}: healthy: 0 of 3 episodes, 0 flags of its files"
    assert [line.split()[:3] for line in healthy[2:]] == [["healthy", str(i), "60"] for i in range(EPISODES)]
    IN_ROWS[Kind.STATE_JUMP](data)
    assert main([str(data), "--pictures=none"]) == 1
    said = capsys.readouterr().out
    assert f"{data}: flagged: 1 of 3 episodes" in said
    assert "episode 1: state_jump: left: joint 4 of the arm jumps by" in said and "(frames 29–32)" in said


def test_the_report_as_json(data, capsys):
    IN_ROWS[Kind.ACTION_JUMP](data)
    assert main([str(data), "--json", "--pictures=none"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert (report["healthy"], report["fps"], Path(report["path"])) == (False, FPS, data)
    assert [episode["healthy"] for episode in report["episodes"]] == [True, False, True]
    (flag,) = [flag for flag in report["episodes"][SICK]["flags"] if flag["kind"] == Kind.ACTION_JUMP]
    assert flag["frames"] == [29, 30]


@pytest.mark.parametrize("case", ["no data set", "old format", "no such arm", "no description"])
def test_wrong_use(case, data, tmp_path, capsys):
    arguments = [str(tmp_path if case == "no data set" else data), "--pictures=none"]
    if case == "old format":
        edit_json(data, "info.json", lambda info: info.update(codebase_version="v2.1"))
    if case == "no such arm":
        arguments.append("--arm=claw")
    if case == "no description":
        (data / "meta" / "info.json").unlink()
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    said = {"no data set": "no directory meta", "old format": "v2.1", "no such arm": "claw", "no description": "info"}
    assert said[case] in capsys.readouterr().err
