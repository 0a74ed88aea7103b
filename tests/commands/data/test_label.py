"""yam-label on data sets of LeRobot's own making."""

import json
import shutil
import subprocess
import sys

import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.commands.data.label import main
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR
from tests.support.wrecks import CAMERAS, LENGTHS, add_frames, create, fingerprint, load


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A data set of three episodes with a video, and figures as a recording leaves them."""
    data = create(tmp_path_factory.mktemp("recorded") / "data", CAMERAS[:1])
    for episode, length in enumerate(LENGTHS):
        add_frames(data, episode, length)
        data.save_episode()
    data.finalize()
    rows = [{"episode_index": i, "frames": length} for i, length in enumerate(LENGTHS)]
    (data.root / SIDE_CAR).write_text("".join(json.dumps(row) + "\n" for row in rows))
    return data.root


@pytest.fixture
def data(recorded, tmp_path):
    return shutil.copytree(recorded, tmp_path / "data")


def labels(root):
    return {episode: row.outcome for episode, row in outcomes.read(root).items()}


def test_it_shows_what_there_is_and_changes_nothing(data, capsys):
    outcomes.append(data, [outcomes.now(1, "failure", "right_bottom")])
    before = fingerprint(data)
    assert main([str(data)]) == 0
    said = capsys.readouterr().out
    assert "right_bottom" in said and "3 episodes: 0 success, 1 failure, 0 discard, 2 without a label" in said
    assert "--apply leaves out no episode" in said
    assert fingerprint(data) == before and not data.with_name("data_labelled").exists()


def test_labels_are_set_taken_back_and_filled_up(data):
    assert main([str(data), "--set", "0-1=failure", "1=discard"]) == 0
    assert labels(data) == {0: "failure", 1: "discard"}
    assert main([str(data), "--set", "0=none", "--rest", "success"]) == 0
    assert labels(data) == {0: "success", 1: "discard", 2: "success"}
    assert main([str(data), "--set", "2=none"]) == 0
    assert labels(data) == {0: "success", 1: "discard"}


def test_applied_it_leaves_out_what_was_discarded_and_writes_columns_that_lerobot_reads(data, capsys):
    before = fingerprint(data)
    main([str(data), "--set", "0=discard", "1=success"])
    assert main([str(data), "--apply"]) == 0
    copy = load(data.with_name("data_labelled"))
    original = load(data)
    assert [row["length"] for row in copy.meta.episodes] == list(LENGTHS[1:])
    successes = [bool(item["next.success"]) for item in copy.hf_dataset]
    assert successes == [i == LENGTHS[1] - 1 for i in range(sum(LENGTHS[1:]))]
    assert [row["success"] for row in copy.meta.episodes] == [True, None]
    picked = LeRobotDataset("local/picked", root=copy.root, episode_filter=lambda row: row["success"])
    assert picked.num_episodes == 1 and len(picked) == LENGTHS[1]
    for index in (0, LENGTHS[1] - 1, len(copy) - 1):
        ours, theirs = copy[index], original[index + LENGTHS[0]]
        assert (ours["action"] == theirs["action"]).all()
        assert abs(ours[CAMERAS[0]] - theirs[CAMERAS[0]]).mean() < 0.02  # encoded once more
    assert labels(copy.root) == {0: "success"}
    rows = [json.loads(line) for line in (copy.root / SIDE_CAR).read_text().splitlines()]
    assert rows == [{"episode_index": i, "frames": length} for i, length in enumerate(LENGTHS[1:])]
    (data / outcomes.OUTCOMES).unlink()
    assert fingerprint(data) == before
    assert not [path for path in data.parent.iterdir() if "partial" in path.name]
    assert "leaves out episodes 0" in capsys.readouterr().out


def test_a_directory_whose_name_looks_like_an_unfinished_copy_is_left_alone(data, tmp_path):
    root = data.rename(tmp_path / "copy.partial")
    before = fingerprint(root)
    assert main([str(root), "--apply", "--output", str(tmp_path / "copy")]) == 0
    assert fingerprint(root) == before and load(tmp_path / "copy").num_episodes == len(LENGTHS)
    assert {path.name for path in tmp_path.iterdir()} == {"copy.partial", "copy"}
    assert (tmp_path / "copy").stat().st_mode == root.stat().st_mode


def test_the_episodes_behind_one_that_is_left_out_keep_their_labels(data):
    main([str(data), "--set", "0=failure", "1=discard", "2=success", "--apply"])
    copy = load(data.with_name("data_labelled"))
    assert [row["length"] for row in copy.meta.episodes] == [LENGTHS[0], LENGTHS[2]]
    assert [row["success"] for row in copy.meta.episodes] == [False, True]
    assert labels(copy.root) == {0: "failure", 1: "success"}
    assert copy[len(copy) - 1]["action"].equal(load(data)[sum(LENGTHS) - 1]["action"])


@pytest.mark.long
def test_without_a_discarded_episode_the_copy_has_all_and_is_not_labelled_again(data, tmp_path, capsys):
    assert main([str(data), "--rest", "failure", "--apply", "--output", str(tmp_path / "all")]) == 0
    copy = load(tmp_path / "all")
    assert [row["success"] for row in copy.meta.episodes] == [False] * 3
    assert not any(copy.hf_dataset["next.success"])
    assert copy.hf_dataset["action"][5].equal(load(data).hf_dataset["action"][5])
    assert main([str(tmp_path / "all"), "--apply"]) == 1
    assert "label the recording that it was made from" in capsys.readouterr().err


MISTAKES = [
    (["--set", "3=failure"], 1, "no episode 3; the data set has 3, numbered from 0"),
    (["--set", "1=sucess"], 2, "labels: success, failure, discard, none"),
    (["--set", "2-1=failure"], 2, "1 is before 2"),
    (["--output", "elsewhere"], 2, "add --apply"),
    (["--rest", "discard", "--apply"], 1, "nothing would be left"),
]


@pytest.mark.parametrize(("arguments", "status", "says"), MISTAKES)
def test_a_mistake_is_a_line(data, capsys, arguments, status, says):
    try:
        assert main([str(data), *arguments]) == status
    except SystemExit as end:
        assert end.code == status
    assert says in capsys.readouterr().err
    assert not data.with_name("data_labelled").exists()


def test_a_directory_that_is_no_data_set(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert "no LeRobot data set" in capsys.readouterr().err
    (tmp_path / "meta").mkdir()
    assert main([str(tmp_path)]) == 1
    assert "yam-repair-dataset" in capsys.readouterr().err


def test_a_line_that_a_power_cut_has_left_is_not_in_the_way(data):
    outcomes.append(data, [outcomes.now(0, "failure", "a")])
    with open(data / outcomes.OUTCOMES, "a") as file:
        file.write('{"episode_index": 1, "outc')
    assert labels(data) == {0: "failure"}
    outcomes.append(data, [outcomes.now(2, "success", "b")])
    assert labels(data) == {0: "failure", 2: "success"}


def test_a_line_that_is_no_outcome_is_named(data, capsys):
    (data / outcomes.OUTCOMES).write_text('{"episode_index": 0, "outcome": "fine"}\n{}\n')
    assert main([str(data)]) == 1
    assert "line 1 is no outcome: 'fine' is none of success, failure, discard" in capsys.readouterr().err


def test_help_is_quick():
    program = "import sys; from lerobot_robot_yam.commands.data.label import main\ntry: main(['--help'])\n"
    program += "except SystemExit: pass\nassert not {'torch', 'lerobot', 'pyarrow'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)
