"""yam-model writes a file, or says why not."""

import pytest

from lerobot_robot_yam.arm.export.model_export import mjcf, urdf
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.commands.model_file import main


@pytest.mark.parametrize(("form", "text"), [("mjcf", mjcf), ("urdf", urdf)])
def test_it_writes_the_arm_that_was_asked_for(form, text, tmp_path, capsys):
    expected = text(*resolve_profiles("big_yam", "crank_4310"))
    path = tmp_path / "new" / "big"
    arguments = ["--arm", "big_yam", "--gripper", "crank_4310", "--format", form]
    assert main([str(path), *arguments]) == 0
    assert path.read_text() == expected
    assert "big_yam with crank_4310" in capsys.readouterr().out
    assert main(arguments) == 0
    assert capsys.readouterr().out == expected


def test_it_says_what_cannot_be(tmp_path, capsys):
    assert main([str(tmp_path / "x.urdf"), "--format", "urdf", "--gripper", "claw"]) == 1
    assert main([str(tmp_path), "--format", "mjcf"]) == 1
    said = capsys.readouterr().err
    assert "unknown gripper 'claw'" in said and f"{tmp_path} cannot be written" in said


@pytest.mark.parametrize("arguments", [[], ["--format", "step"]])
def test_wrong_arguments(arguments):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
