"""What yam-dataset-check says, and its exit status; tests/face/datasets/check/ has what it finds."""

import json
from pathlib import Path

import pytest

from lerobot_robot_yam.commands.data.dataset_check import main
from lerobot_robot_yam.face.datasets.check.flags import Kind
from tests.support import seeded_sets as seeds
from tests.support.seeded_sets import FPS, ROWS, SICK, STATE, edit_json, edit_rows


@pytest.fixture
def data(tmp_path):
    """Three episodes without pictures."""
    return seeds.write(tmp_path / "data", [seeds.motion(episode) for episode in range(3)], ())


def jump(root, column):
    def edit(columns):
        columns[column][ROWS][30:, 1] += 0.5

    edit_rows(root, edit)


def test_what_the_command_says(data, capsys):
    assert main([str(data)]) == 0
    healthy = capsys.readouterr().out.splitlines()
    assert healthy[0] == f"{data}: healthy: 0 of 3 episodes, 0 flags of its files"
    assert [line.split()[:3] for line in healthy[2:]] == [["healthy", str(i), "60"] for i in range(3)]
    jump(data, STATE)
    assert main([str(data), "--pictures=none"]) == 1
    said = capsys.readouterr().out
    assert f"{data}: flagged: 1 of 3 episodes" in said
    assert "episode 1: state_jump: left: joint 2 of the arm jumps by" in said and "(frames 29–30)" in said


def test_the_report_as_json(data, capsys):
    jump(data, "action")
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
