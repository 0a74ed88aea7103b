import json

from lerobot_robot_yam.arm.estop import EmergencyStop
from lerobot_robot_yam.commands.estop import main


def test_latch_status_release(capsys):
    assert main(["status"]) == 0
    assert main(["--why", "a test"]) == 0
    assert EmergencyStop().latched and "a test" in EmergencyStop().reason()
    assert main(["status"]) == 1
    capsys.readouterr()
    main(["status", "--json"])
    assert json.loads(capsys.readouterr().out)["latched"]
    main(["--why", "later"])
    assert "a test" in EmergencyStop().reason()  # the first reason stands
    assert main(["release"]) == 0
    assert not EmergencyStop().latched
    assert main(["release"]) == 0


def test_a_stop_that_nobody_hears_of_is_an_error(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("lerobot_robot_yam.arm.estop.runtime_dir", lambda: tmp_path / "gone")
    assert main([]) == 1
    said = capsys.readouterr()
    assert "NOTHING IS STOPPED" in said.err and not said.out
