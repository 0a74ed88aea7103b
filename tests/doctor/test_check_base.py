"""yam-doctor on a base's channel: what is right, what is wrong with its motors, and the channel of an arm."""

import contextlib
import dataclasses

import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import ControlMode, Fault
from lerobot_robot_yam.doctor.kit.targets import BaseTarget, Target, from_config, from_option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.base_profile import BaseProfile
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_base import YamBase
from tests.mobile.rails import Rail
from tests.support.base_rig import motors
from tests.support.doctor_desk import examine_arm, examine_target, found


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("mobile")) as rig:
        yield rig


def examine(rig, channel="base", samples=0, rail=None):
    config = BaseConfig(channel=channel, interface="yam_lockstep", can_options={"rig": rig.name}, rail=rail)
    return examine_target(BaseTarget(config), samples)


def test_a_healthy_base(rig):
    status, report = examine(rig, samples=2)
    assert status == 0 and not [f for f in report["findings"] if f["severity"] != "note"]
    assert [row["name"] for row in report["motors"]] == list(motors(rig)) and len(report["latency"]) == 8
    assert {row["control_mode"] for row in report["motors"]} == {ControlMode.VELOCITY}
    assert report["channels"] == [{"channel": "base", "arm": "base", "gripper": None, "examined": "asked"}]


def test_defects_of_motors_are_named_with_the_command_that_repairs_them(rig):
    rig.fault("base", "rear_left_steer", "register", ControlMode.MIT, register=int(Register.CTRL_MODE))
    rig.fault("base", "rear_left_drive", "register", 45.0, register=int(Register.VMAX))
    rig.fault("base", "front_left_steer", "register", 0, register=int(Register.TIMEOUT))
    rig.fault("base", "front_left_drive", "register", 40.0, register=int(Register.GR))
    rig.fault("base", "front_right_steer", "nibble", int(Fault.OVERLOAD))
    rig.fault("base", "rear_right_drive", "silent")
    status, report = examine(rig)
    assert status == 1
    (mode,) = found(report, "problem", "rear_left_steer", "CTRL_MODE is 1 instead of 3")
    assert mode["remedy"].startswith("yam-motors write --channel base ") and "--arm base" in mode["remedy"]
    assert found(report, "problem", "rear_left_drive", "VMAX is 45 instead of 30")
    (never,) = found(report, "problem", "front_left_steer", "it never switches itself off")
    assert never["remedy"].startswith("yam-motors timeout --channel base ")
    assert found(report, "problem", "front_left_drive", "another motor than the profile says")
    assert found(report, "problem", "front_right_steer", "overload")
    (silent,) = found(report, "problem", "rear_right_drive", "no answer")
    assert "the base's power" in silent["remedy"]


def test_a_rail_its_board_and_its_switches(tmp_path):
    with contextlib.closing(Rail(tmp_path, height_m=0.0).rig) as rig:
        status, report = examine(rig)
        (note,) = found(report, "note", "base motor id 9", "a rail's motor answers")
        assert status == 0 and "`rail`" in note["remedy"] and not report["rails"]
        status, report = examine(rig, rail={"io": "sim"})
        (row,) = report["rails"]
        assert status == 0 and row["lower"] and not row["upper"] and row["brake_on"] and not row["homed"]
        assert found(report, "note", "base rail", "its height is not known") and len(report["motors"]) == 9
        status, report = examine(rig, rail={"io": "sim", "calibration_path": str(tmp_path / "rail.json")})
        assert status == 0 and report["rails"][0]["homed"] and not found(report, "note", "base rail")
        rig.fault("base_io", None, "switches", {"upper": True, "lower": True})
        assert found(examine(rig, rail={"io": "sim"})[1], "problem", "base rail", "both switches read as triggered")
        rig.fault("base_io", None, "handle_silent", True)
        assert found(
            examine(rig, rail={"io": "sim"})[1], "problem", "base rail", "switches and brake (sim) do not answer"
        )


def test_a_channel_with_the_other_kind_is_said_in_one_problem(rig):
    status, report = examine_arm(rig, "base")
    (problem,) = found(report, "problem", "base")
    assert status == 1 and problem["what"] == "it carries a mobile base" and "--channel base:base" in problem["remedy"]
    config = ArmConfig(channel="base", interface="yam_lockstep", can_options={"rig": rig.name})
    status, report = examine_target(Target(config, declared=False))
    assert status == 0 and len(report["motors"]) == 8
    with contextlib.closing(LockstepRig(arms=["follower_left"])) as arms:
        status, report = examine(arms, "follower_left")
    (problem,) = found(report, "problem", "follower_left")
    assert status == 1 and problem["what"] == "it carries an arm"


def test_a_base_in_a_session_is_watched():
    with running_rig(scene="mobile") as rig:
        config = BaseConfig(channel="base", interface="yam_sim", can_options={"rig": rig.name})
        with YamBase(config):
            status, report = examine_target(BaseTarget(config))
    assert status == 0 and [row["name"] for row in report["sessions"]] == [m.name for m in BaseProfile().motors()]
    assert {row["mode"] for row in report["sessions"]} == {"hold"} and not report["motors"]


def test_bases_of_options_and_run_configs(tmp_path):
    assert from_option("can_base:base", "socketcan", None) == BaseTarget(
        BaseConfig(channel="can_base", name="can_base")
    )
    path = tmp_path / "run.yaml"
    path.write_text("robot: {type: yam_base, channel: can_base, wheel_radius_m: 0.051, observe_odometry: true}\n")
    (target,) = from_config(path, None).targets
    assert target.config == BaseConfig(channel="can_base", name="base", wheel_radius_m=0.051)
    arms = "".join(f"{side}_arm_config: {{channel: can_{side}}}, " for side in ("left", "right"))
    path.write_text(f"robot: {{type: yam_mobile, {arms}base_config: {{channel: can_base}}}}\n")
    plan = from_config(path, None)
    assert [target.channel for target in plan.targets] == ["can_left", "can_right", "can_base"]
    assert plan.followers == plan.targets[:2] and dataclasses.asdict(plan.targets[2].config)["channel"] == "can_base"
    path.write_text(f"robot: {{type: yam_mobile, {arms}base_config: {{channel: can_left}}}}\n")
    with pytest.raises(ConfigError, match="can_left"):
        from_config(path, None)
