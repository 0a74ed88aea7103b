"""yam-repair-dataset on what LeRobot's own writer leaves when it is killed.

A copy of the directory, made while the writer is open, holds what kill -9 leaves: nothing is buffered but what is in
the process. Meanwhile the writer goes on and finishes, so that each wreck has its whole counterpart to compare with.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.commands.data.repair_dataset import main
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR
from tests.support.tiers import spread
from tests.support.wrecks import (
    CAMERAS,
    CODER,
    DEPTH,
    add_frames,
    assert_same,
    brightness,
    create,
    fingerprint,
    load,
    wreck,
)


def repair(path, *arguments):
    """Exit status; the original must be as it was."""
    before = fingerprint(path)
    status = main([str(path), *arguments])
    assert fingerprint(path) == before
    return status


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """(wreck, whole) of three episodes of two cameras."""
    directory = tmp_path_factory.mktemp("killed")
    wreck(create(directory / "whole"), directory / "wreck")
    return directory / "wreck", directory / "whole"


@pytest.fixture
def copy(killed, tmp_path):
    """A copy of the wreck, to damage further."""
    shutil.copytree(killed[0], tmp_path / "data")
    return tmp_path / "data"


def test_nothing_of_a_killed_recording_loads_until_it_is_repaired(killed, tmp_path, capsys):
    broken, whole = killed
    with pytest.raises(Exception):  # noqa: B017 LeRobot looks for it on the Hub, whatever comes of that
        load(broken)
    assert repair(broken, "--dry-run") == 0
    assert not broken.with_name("wreck_repaired").exists()
    assert repair(broken, f"--output={tmp_path / 'new'}") == 0
    assert_same(tmp_path / "new", whole)
    said = capsys.readouterr().out
    assert "3 of 3 episodes (0–2), 36 frames" in said and "left by the episode that was being recorded" in said
    assert [path.name for path in sorted((tmp_path / "new").iterdir())] == ["data", "meta", "videos"]


@pytest.mark.long
def test_the_default_output_lies_beside_the_original_with_what_lay_beside_the_data(copy):
    """But for the label of an episode that is lost."""
    kept = ("notes/monday.txt", "meta/annotations/grasps.json")
    for name in kept:
        (copy / name).parent.mkdir()
        (copy / name).write_text("kept")
    outcomes.append(copy, [outcomes.now(3, "discard", "top")])
    assert repair(copy) == 0
    new = copy.with_name("data_repaired")
    assert load(new).num_episodes == 3
    assert [(new / name).read_text() for name in kept] == ["kept", "kept"] and not (new / outcomes.OUTCOMES).exists()


def test_a_whole_data_set_is_healthy(killed, capsys):
    assert repair(killed[1]) == 0
    assert "healthy, 3 episodes" in capsys.readouterr().out
    assert not killed[1].with_name("whole_repaired").exists()


@pytest.mark.parametrize("form", spread(["images first", "in the rows", "depth"], 1))
def test_other_forms_of_pictures(form, tmp_path):
    cameras = (*CAMERAS[:1], DEPTH) if form == "depth" else CAMERAS
    dtype = "image" if form == "in the rows" else "video"
    wreck(create(tmp_path / "whole", cameras, dtype, streaming=form == "depth"), tmp_path / "wreck", (7, 5))
    assert repair(tmp_path / "wreck") == 0
    assert_same(tmp_path / "wreck_repaired", tmp_path / "whole")


def resumed(root):
    return LeRobotDataset.resume("local/wreck", root=root, streaming_encoding=True, rgb_encoder=CODER)


@pytest.mark.long
def test_a_repaired_data_set_can_be_resumed_and_killed_again(tmp_path):
    wreck(create(tmp_path / "whole", CAMERAS[:1]), tmp_path / "killed", (5, 8))
    assert repair(tmp_path / "killed", f"--output={tmp_path / 'one'}") == 0
    wreck(resumed(tmp_path / "one"), tmp_path / "wreck", (7,), saved=2)
    assert repair(tmp_path / "wreck") == 0
    assert_same(tmp_path / "wreck_repaired", tmp_path / "one")
    assert load(tmp_path / "wreck_repaired").num_episodes == 3


def test_metadata_that_were_flushed_without_a_footer(tmp_path):
    wreck(create(tmp_path / "whole", ()), tmp_path / "wreck", (3,) * 12)
    (flushed,) = (tmp_path / "wreck" / "meta" / "episodes").rglob("*.parquet")
    with pytest.raises(pa.ArrowInvalid):
        pq.ParquetFile(flushed)
    assert repair(tmp_path / "wreck") == 0
    assert_same(tmp_path / "wreck_repaired", tmp_path / "whole")


def test_killed_while_an_episode_was_being_saved(tmp_path, capsys):
    data = create(tmp_path / "whole", CAMERAS[:1])
    wreck_of_one = tmp_path / "one"
    add_frames(data, 0, 12)
    data.save_episode()
    shutil.copytree(data.root, wreck_of_one)
    wreck(data, tmp_path / "two", (9,), saved=1)
    for name in ("meta/tasks.parquet", "data/chunk-000/file-000.parquet"):  # what is written first
        shutil.copy(tmp_path / "two" / name, wreck_of_one / name)
    assert repair(wreck_of_one) == 0
    said = capsys.readouterr().out
    assert "lost: episode 1: no video" in said and "1 of 2 episodes (0), 12 frames" in said
    assert load(tmp_path / "one_repaired").num_frames == 12


def test_rows_of_an_interrupted_save_are_left_out(tmp_path, monkeypatch, capsys):
    data = create(tmp_path / "data", CAMERAS[:1])
    for episode in range(2):
        add_frames(data, episode, 6)
        if episode:
            monkeypatch.setattr(data.meta, "save_episode", interrupt)
            with pytest.raises(KeyboardInterrupt):
                data.save_episode()
        else:
            data.save_episode()
    data.finalize()
    again = resumed(tmp_path / "data")
    add_frames(again, 1, 8)
    again.save_episode()
    again.finalize()
    assert repair(tmp_path / "data") == 0
    assert "saving was interrupted" in capsys.readouterr().out
    repaired = load(tmp_path / "data_repaired")
    assert [row["length"] for row in repaired.meta.episodes] == [6, 8]
    assert repaired[6]["frame_index"] == 0 and len(repaired.hf_dataset) == 14


@pytest.mark.long
def test_rows_of_an_interrupted_save_are_left_out_of_a_killed_recording_too(tmp_path, monkeypatch, capsys):
    """As long as the next episode, they would be given its pictures, and that one those of the last."""
    data = create(tmp_path / "data", CAMERAS[:1])
    add_frames(data, 0, 5)
    data.save_episode()
    add_frames(data, 1, 6)
    monkeypatch.setattr(data.writer, "_save_episode_video", interrupt)
    with pytest.raises(KeyboardInterrupt):
        data.save_episode()
    data.finalize()
    wreck(resumed(tmp_path / "data"), tmp_path / "wreck", (6, 6), saved=1)
    assert repair(tmp_path / "wreck") == 0
    assert capsys.readouterr().out.count("saving was interrupted") == 1
    repaired = load(tmp_path / "wreck_repaired")
    assert [row["length"] for row in repaired.meta.episodes] == [5, 6, 6]
    for index, (episode, frame) in {5: (1, 0), 10: (1, 5), 11: (2, 0), 16: (2, 5)}.items():
        item = repaired[index]
        assert (item["episode_index"], item["frame_index"]) == (episode, frame)
        assert item[CAMERAS[0]].mean() * 255 == pytest.approx(brightness(CAMERAS[0], episode, frame), abs=2)


def test_episodes_whose_videos_were_to_be_encoded_together_are_lost_and_named(killed, tmp_path, capsys):
    """LeRobot saves their metadata first, without saying where their videos will be."""
    shutil.copytree(killed[1], tmp_path / "data")
    (path,) = (tmp_path / "data" / "meta" / "episodes").rglob("*.parquet")
    table = pq.read_table(path)
    pq.write_table(table.drop([name for name in table.column_names if name.startswith("videos/")]), path)
    shutil.rmtree(tmp_path / "data" / "videos")
    assert repair(tmp_path / "data") == 1
    assert "lost: episode 2: no video" in capsys.readouterr().out


def interrupt(*arguments, **options):
    raise KeyboardInterrupt


def test_dropped_frames_make_the_episodes_of_a_file_ambiguous(copy, tmp_path, capsys):
    wreck(create(tmp_path / "other"), tmp_path / "fewer", (11, 9, 15))  # one frame less
    video = Path("videos") / CAMERAS[1] / "chunk-000" / "file-000.mp4"
    shutil.copy(tmp_path / "fewer" / video, copy / video)
    assert repair(copy) == 1
    said = capsys.readouterr()
    assert f"{video} has 35 frames" in said.out and "no episode can be recovered" in said.out
    assert not copy.with_name("data_repaired").exists()


def test_a_video_that_is_cut_off_costs_the_last_episodes(killed, tmp_path, capsys):
    shutil.copytree(killed[1], tmp_path / "data")  # with metadata: here nobody was killed, the disk was full
    video = tmp_path / "data" / "videos" / CAMERAS[0] / "chunk-000" / "file-000.mp4"
    content = video.read_bytes()
    video.write_bytes(content[: content.index(b"mdat") + (len(content) - content.index(b"mdat")) * 7 // 10])
    assert repair(tmp_path / "data") == 0
    assert "lost: episode 2:" in capsys.readouterr().out
    repaired = load(tmp_path / "data_repaired")
    assert repaired.num_episodes in (1, 2)
    assert repaired.meta.stats["action"]["count"][0] == repaired.num_frames


def test_a_lost_episode_in_the_middle_renumbers_those_behind_it(killed, tmp_path, capsys):
    shutil.copytree(killed[1], tmp_path / "data")
    (path,) = (tmp_path / "data" / "data").rglob("*.parquet")
    table = pq.read_table(path)
    pq.write_table(pa.concat_tables([table.slice(0, 12), table.slice(21)]), path)
    outcomes.append(tmp_path / "data", [outcomes.now(episode, "discard", "top") for episode in (1, 2, 3)])
    figures = [{"episode_index": episode, "frames": length} for episode, length in enumerate((12, 9, 15))]
    (tmp_path / "data" / SIDE_CAR).write_text("\n".join(map(json.dumps, figures)) + '\n{"episode_ind')
    assert repair(tmp_path / "data") == 0
    said = capsys.readouterr().out
    assert "lost: episode 1: its rows are not on disk" in said and "numbered anew" in said
    repaired, whole = load(tmp_path / "data_repaired"), load(killed[1])
    assert [row["length"] for row in repaired.meta.episodes] == [12, 15]
    assert {i: row.by for i, row in outcomes.read(repaired.root).items()} == {1: "top"}
    rows = [json.loads(line) for line in (repaired.root / SIDE_CAR).read_text().splitlines()]
    assert rows == [{"episode_index": 0, "frames": 12}, {"episode_index": 1, "frames": 15}]
    assert repaired.hf_dataset.data.column("index").to_pylist() == list(range(27))
    np.testing.assert_array_equal(repaired[12]["action"], whole[21]["action"])
    np.testing.assert_array_equal(repaired[26][CAMERAS[1]], whole[35][CAMERAS[1]])


@pytest.mark.parametrize("name", ["info.json", "tasks.parquet"])
def test_what_cannot_be_guessed_is_named(name, copy, capsys):
    (copy / "meta" / name).write_bytes(b"")
    assert repair(copy) == 1
    assert name in capsys.readouterr().err


def test_a_recording_that_was_killed_in_its_first_episode_has_nothing(tmp_path, capsys):
    data = create(tmp_path / "whole")
    add_frames(data, 0, 5)
    shutil.copytree(data.root, tmp_path / "data")
    data.clear_episode_buffer()
    data.finalize()
    assert repair(tmp_path / "data") == 1
    said = capsys.readouterr().err
    assert "no episode was saved" in said and "copy" not in said


def test_no_rows_at_all(copy, capsys):
    (path,) = (copy / "data").rglob("*.parquet")
    path.write_bytes(path.read_bytes()[:100])
    assert repair(copy) == 1
    assert "lost: episode 2: its rows are not on disk" in capsys.readouterr().out


@pytest.mark.parametrize("case", ["no data set", "output exists", "output inside"])
def test_wrong_arguments(case, copy, tmp_path):
    arguments = {
        "no data set": [str(tmp_path)],
        "output exists": [str(copy), f"--output={tmp_path}"],
        "output inside": [str(copy), f"--output={copy / 'new'}"],
    }[case]
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
