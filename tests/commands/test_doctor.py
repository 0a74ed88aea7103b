"""The command on a healthy rig: its report, its targets, its exit status."""

import pytest

from lerobot_robot_yam.commands.configs import config_path
from lerobot_robot_yam.commands.doctor import main
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from tests.support.doctor_desk import FOLLOWER, LEADER, LEADER_ARM, examine, found, virtual


@pytest.fixture(scope="module")
def rig():
    with running_rig(arms=[FOLLOWER, LEADER]) as rig:
        yield rig


def test_a_healthy_rig(rig, capsys):
    status, report = examine(capsys, *virtual(rig, FOLLOWER, LEADER_ARM, samples=20))
    assert status == 0, report["findings"]
    assert report["healthy"] and report["counts"]["problem"] == 0
    assert [row["examined"] for row in report["channels"]] == ["asked", "asked"]
    motors = [row for row in report["motors"] if row["channel"] == FOLLOWER]
    assert [row["id"] for row in motors] == [1, 2, 3, 4, 5, 6, 7]
    first = motors[0]
    assert (first["firmware"], first["hardware"], first["firmware_sub"]) == (5013, 10, 0)
    assert (first["position_max_rad"], first["velocity_max_rad_s"], first["torque_max_nm"]) == (12.5, 10, 28)
    assert (first["gear_ratio"], first["timeout_s"], first["control_mode"], first["answers_on"]) == (40, 0.4, 1, 17)
    assert first["supply_v"] == 24 and first["fault"] == 0 and 30 < first["temp_rotor_c"] < 50
    (handle,) = report["handles"]
    assert (handle["firmware"], handle["report_frequency_hz"], handle["trigger"]) == ("2.4.0", 0, 0)
    assert len(report["latency"]) == 13
    for row in report["latency"]:
        assert row["samples"] == 20 and row["lost"] == 0 and sum(row["counts"]) == 20
        assert 0.2 < row["p50_ms"] <= row["p99_ms"] <= row["max_ms"]  # two frames take 0.26 ms of wire
    assert "granted to the control loop" in [row["what"] for row in report["host"]]


def test_the_plain_report_begins_with_the_verdict_and_has_tables_where_they_are_asked_for(rig, capsys):
    assert main(virtual(rig, FOLLOWER)) == 0
    out, err = capsys.readouterr()
    assert out.startswith("healthy: 0 problems") and "--verbose" in out and "DM4340" not in out
    assert f"{FOLLOWER}: listening" in err
    assert main([*virtual(rig, FOLLOWER), "--verbose"]) == 0
    out = capsys.readouterr().out
    for words in ("healthy: 0 problems", "Motors", "joint_1", "DM4340", "Reply latency", "p99 ms", "This computer"):
        assert words in out


def test_the_shipped_sim_config_is_healthy(capsys):
    with running_rig() as rig:
        status, report = examine(
            capsys, f"--config_path={config_path('sim/record')}", f"--rig={rig.name}", "--samples=1"
        )
        assert status == 0, report["findings"]
        assert len(report["channels"]) == 4


def test_a_latched_emergency_stop(rig, capsys):
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        status, report = examine(capsys, *virtual(rig, FOLLOWER, samples=0))
    finally:
        stop.release()
    assert status == 1
    (problem,) = found(report, "problem", "this computer", "a test")
    assert "yam-estop release" in problem["remedy"]


def test_a_binding_that_is_configured_and_not_there(rig, capsys, tmp_path):
    """The first run finds it missing, with the command that makes it; the arms are examined all the same."""
    path = tmp_path / "run.yaml"
    arm = f"interface: yam_sim, channel: {FOLLOWER}, identity_path: {tmp_path}/arm.json"
    path.write_text(f"robot: {{type: yam_follower, {arm}, gripper_stops_rad: [3.25, -3.3]}}\n")
    status, report = examine(capsys, f"--config_path={path}", f"--rig={rig.name}", "--samples=0")
    assert status == 1 and len(report["motors"]) == 7
    (problem,) = found(report, "problem", FOLLOWER, "identity_path")
    assert problem["remedy"] == f"yam-identify --channel {FOLLOWER} --rig {rig.name} --bind {tmp_path}/arm.json"


@pytest.mark.parametrize(
    "arguments",
    [
        ["--interface=yam_sim"],
        ["--channel=a:b:c:d"],
        ["--channel=can0:no_such_arm"],
        ["--channel=can0", "--channel=can0"],
        ["--config_path=no_such_file.yaml"],
        ["--channel=can0", "--config_path=x.yaml"],
        ["--channel=can0", "--samples=-1"],
        ["--channel=can0", "--interface=yam_sim", "--rig=auto:nobody"],
    ],
)
def test_wrong_usage(arguments, capsys):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("yam-doctor: ")


def test_an_unknown_option_is_wrong_usage(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--no-such-option"])
    assert end.value.code == 2
    assert "usage" in capsys.readouterr().err
