"""Files that lie about are none of ours: in the working directory, or python-can's own configuration."""

import can

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.arm_session import ArmSession
from tests.support.rigged import sim_config


def test_a_file_in_the_working_directory_does_not_take_the_place_of_a_module(tmp_path, monkeypatch):
    for name in ("can", "queue", "select"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('not the module')\n")
    monkeypatch.chdir(tmp_path)
    with running_rig(arms=["follower_left"]) as rig:
        session = ArmSession([sim_config(rig, "follower_left")])
        session.start()
        try:
            assert session["follower_left"].observe().q.shape == (6,)
        finally:
            session.stop()


def test_python_cans_own_configuration_does_not_reach_an_arm(monkeypatch):
    monkeypatch.setenv("CAN_CONFIG", '{"receive_own_messages": true}')
    with open_bus(ArmConfig(channel="desk", interface="virtual")) as bus:
        bus.send(can.Message(arbitration_id=1))
        assert bus.recv(0.0) is None
