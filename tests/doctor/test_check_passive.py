"""A leader without motors under the doctor's eyes: encoders, zeros, trigger, and a session that reads it."""

import json
import time

import pytest

from lerobot_robot_yam.arm.config import LeadArmConfig
from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS, PassiveConfig
from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID
from lerobot_robot_yam.damiao.tables import REGISTER_ID
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.arm_session import ArmSession
from tests.support.doctor_desk import LEADER, examine, examine_target, found
from tests.support.rigged import rig_of

ZEROS = {"version": 1, "zero_rad": [0.0] * 6, "range_rad": [[-1.0, 1.0]] * 6, "trigger_rad": 0.67}


@pytest.fixture
def rig():
    with rig_of("lockstep", scene="passive_leaders", arms=[LEADER]) as rig:
        yield rig


@pytest.fixture
def leader(rig, tmp_path):
    """Examines the leader, with zeros of its own and more options; returns status and report."""
    zeros, config = tmp_path / "zeros.json", tmp_path / "config.yaml"
    zeros.write_text(json.dumps(ZEROS))

    def look(**options):
        where = {"channel": LEADER, "interface": "yam_lockstep", "can_options": {"rig": rig.name}}
        of_arm = {**where, "passive_calibration_path": str(zeros)} | options
        config.write_text(json.dumps({"teleop": {"type": "yam_passive_leader", "id": "lab", **of_arm}}))
        (target,) = from_config(config, None).targets
        return examine_target(target)

    return look


def test_one_that_is_well(rig, leader):
    rig.trace_start(LEADER)
    status, report = leader()
    assert status == 0 and not found(report, "problem", "") and not found(report, "warning", LEADER)
    assert {identifier for _, _, identifier, _ in rig.trace(LEADER)} == {REQUEST_ID, REGISTER_ID}
    (row,) = report["passive_leaders"]
    assert row["q_rad"] == pytest.approx(rig.state()["arms"][LEADER]["q"], abs=0.01)
    assert row["silent"] == [] and row["trigger"] == 0.0
    assert not report["motors"] and report["channels"][0]["examined"] == "asked"


def test_what_is_wrong_with_one(rig, leader, tmp_path):
    rig.fault(LEADER, None, "encoders_silent", [2])
    rig.trigger(LEADER, 0.8)
    turned = tmp_path / "turned.json"
    turned.write_text(json.dumps(ZEROS | {"zero_rad": [0.0, 2.0, 0.0, 0.0, 0.0, 0.0]}))
    status, report = leader(passive_calibration_path=str(turned))
    assert status == 1
    assert [f["where"] for f in found(report, "problem", LEADER)] == [f"{LEADER} joint_3"]
    assert found(report, "warning", LEADER, "the trigger reads 0.8")
    assert found(report, "warning", f"{LEADER} joint_2", "beyond its follower's 0.00")


def test_one_without_zeros(leader, tmp_path):
    status, report = leader(passive_calibration_path=str(tmp_path / "none.json"))
    assert status == 0
    (zeros,) = found(report, "warning", LEADER, "no zeros are stored")
    assert "lerobot-calibrate --teleop.type=yam_passive_leader --teleop.id=lab" in zeros["remedy"]


def test_one_that_is_not_there(rig, leader):
    rig.fault(LEADER, None, "encoders_silent", True)
    status, report = leader()
    assert status == 1 and found(report, "problem", LEADER, "none of its encoders answers")


def test_zeros_that_cannot_be_used(leader, tmp_path):
    broken = tmp_path / "broken.json"
    broken.write_text("{}")
    status, report = leader(passive_calibration_path=str(broken))
    (problem,) = found(report, "problem", LEADER, "is no calibration")
    assert status == 1 and problem["remedy"].startswith(f"rm {broken} && lerobot-calibrate")


def test_a_session_that_reads_one_is_watched(tmp_path, capsys):
    with running_rig(scene="passive_leaders", arms=[LEADER]) as rig:
        of_rig = {"channel": LEADER, "interface": "yam_sim", "can_options": {"rig": rig.name}}
        config, passive = tmp_path / "config.yaml", PassiveConfig(joint_sign=JOINT_SIGNS["desk"])
        config.write_text(json.dumps({"teleop": {"type": "yam_passive_leader", **of_rig}}))
        session = ArmSession(
            [LeadArmConfig(name="left", gripper="yam_teaching_handle", start="float", passive=passive, **of_rig)]
        )
        session.start()
        try:
            status, report = examine(capsys, f"--config_path={config}")
            assert status == 0 and not found(report, "problem", "")
            assert {row["name"] for row in report["sessions"]} == {f"joint_{i + 1}" for i in range(6)}
            rig.fault(LEADER, None, "encoders_silent", [4])
            time.sleep(0.3)
            status, report = examine(capsys, f"--config_path={config}")
            assert status == 1 and found(report, "problem", f"{LEADER} joint_5", "has not been heard for")
        finally:
            session.stop()
