"""yam-urdf writes a file, or says why not."""

from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.urdf_export import urdf
from lerobot_robot_yam.commands.urdf import main


def test_it_writes_the_arm_that_was_asked_for(tmp_path):
    path = tmp_path / "new" / "big.urdf"
    assert main([str(path), "--arm", "big_yam", "--gripper", "crank_4310"]) == 0
    assert path.read_text() == urdf(*resolve_profiles("big_yam", "crank_4310"))


def test_it_says_what_cannot_be(tmp_path, capsys):
    assert main([str(tmp_path / "x.urdf"), "--gripper", "claw"]) == 1
    assert main([str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert "unknown gripper 'claw'" in said and f"{tmp_path} cannot be written" in said
