"""The last lines of a recording: what is kept, what is wrong with it, and what to do."""

import json
import logging
import shutil
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR, _say_kept
from tests.support.wrecks import create, wreck


def data_set(episodes=0):
    return SimpleNamespace(num_episodes=episodes)


def test_a_data_set_that_was_not_written_to_its_end_is_said_to_need_repair(tmp_path, caplog):
    """As a disk leaves it that was full to the last byte: what LeRobot keeps in memory until the end is missing."""
    data = create(tmp_path / "whole", cameras=())
    wreck(data, tmp_path / "torn", lengths=(4, 3))
    for name, torn in (("whole", False), ("torn", True)):
        caplog.clear()
        _say_kept(data, tmp_path / name, 0, False)
        said = f"yam-repair-dataset {tmp_path / name}" in caplog.text and "THE DATA SET DOES NOT LOAD" in caplog.text
        assert said == torn == any(record.levelno == logging.ERROR for record in caplog.records)
    shutil.copytree(tmp_path / "whole", tmp_path / "no rows")
    shutil.rmtree(tmp_path / "no rows" / "meta" / "episodes")
    _say_kept(data, tmp_path / "no rows", 0, False)
    assert "meta/episodes has 0 of 2 episodes" in caplog.text


def recorded(root, episodes, *files):
    (root / "meta" / "episodes").mkdir(parents=True)
    if episodes:
        pq.write_table(pa.table({"episode_index": range(episodes)}), root / "meta" / "episodes" / "file-000.parquet")
    (root / "meta" / "info.json").write_text(json.dumps({"total_episodes": episodes}))
    for name in files:
        (root / name).touch()
    return root


def test_an_empty_data_set_is_removed(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    root = recorded(tmp_path / "cubes", 0)
    _say_kept(data_set(), root, 0, False)
    assert not root.exists() and f"removed the empty data set {root}" in caplog.text


@pytest.mark.parametrize(
    ("episodes", "files", "resumes"),
    [(50, (), False), (0, ("file-000.parquet",), False), (0, ("frame.png",), False), (0, (), True)],
    ids=["recorded since", "rows without an episode", "images", "was there before"],
)
def test_what_may_hold_something_stays(tmp_path, episodes, files, resumes):
    root = recorded(tmp_path / "cubes", episodes, *files)
    _say_kept(data_set(), root, 0, resumes)
    assert root.exists()


def figures(episode, fps):
    """A row of the side-car of an episode of 2 s that came at so many frames per second."""
    times = np.arange(0.0, 2.0, 1.0 / fps).round(4).tolist()
    return {"episode_index": episode, "fps": 30, "times_s": times, "repeated_images": {"top": 3}}


@pytest.mark.parametrize("slow", [(), (1,), (1, 2, 3, 4), (0, 1, 2, 3, 4)])
def test_episodes_that_harm_a_training_are_told_last_with_what_to_do(tmp_path, caplog, slow):
    """The episode that was there before this session is not told of."""
    caplog.set_level(logging.INFO)
    root = recorded(tmp_path / "my cubes", 5)
    rows = [figures(episode, 20.0 if episode in slow else 30.0) for episode in range(5)]
    (root / SIDE_CAR).write_text("".join(json.dumps(row) + "\n" for row in rows))
    _say_kept(data_set(5), root, 1, True)
    (record,) = caplog.records
    first, *lines = record.getMessage().split("\n  ")
    bad = [episode for episode in slow if episode]
    assert first == f"kept 4 episodes of this session; 5 in {root}"
    assert record.levelno == (logging.WARNING if bad else logging.INFO)
    for episode, line in zip(bad[:3], lines, strict=False):
        assert line.startswith(f"episode {episode}: recorded at 20.0 fps, stamped with 30; ")
        assert "end other programs" in line
    if len(bad) > 3:
        assert lines[3] == f"and 1 more; see yam-dataset-check '{root}'"
    labels = " ".join(f"{episode}=discard" for episode in bad)
    assert not bad or lines[-1].endswith(f": yam-label '{root}' --set {labels} --apply")
    assert len(lines) == min(len(bad), 3) + (len(bad) > 3) + bool(bad)
