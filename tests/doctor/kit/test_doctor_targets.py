"""Which arms are looked at, and which calibration files are theirs."""

from pathlib import Path

import pytest

from lerobot_robot_yam.arm.config import passive_of
from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS
from lerobot_robot_yam.commands.configs import config_path
from lerobot_robot_yam.doctor.check_calibration import check_calibrations
from lerobot_robot_yam.doctor.kit.findings import Section, Severity
from lerobot_robot_yam.doctor.kit.targets import calibration_root, from_config, from_option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.config_refusal import check_options


def test_a_channel_option():
    target = from_option("can_x", "socketcan", None)
    assert (target.config.arm, target.config.gripper, target.key, target.real) == ("yam", "linear_4310", "can_x", True)
    target = from_option("can_x:big_yam:crank_4310", "yam_sim", "shared")
    assert (target.config.arm, target.config.gripper) == ("big_yam", "crank_4310")
    assert target.key == "shared.can_x" and not target.real
    assert from_option("can_x::yam_teaching_handle", "socketcan", None).config.gripper == "yam_teaching_handle"


@pytest.mark.parametrize("text", ["", ":yam", "a:b:c:d", "can0:no_such_arm", "can0:yam:no_such_gripper"])
def test_a_wrong_channel_option(text):
    with pytest.raises(ConfigError):
        from_option(text, "socketcan", None)


def test_the_shipped_configs():
    plan = from_config(config_path("real/record"), None)
    assert [(t.channel, t.config.gripper) for t in plan.targets] == [
        ("can_follower_l", "linear_4310"),
        ("can_follower_r", "linear_4310"),
        ("can_leader_l", "yam_teaching_handle"),
        ("can_leader_r", "yam_teaching_handle"),
    ]
    assert set(plan.cameras) == {"top", "wrist_left", "wrist_right"} and plan.real
    expected = calibration_root() / "robots/bi_yam_follower/yam/left_lab_gripper.json"
    assert plan.targets[0].calibration == expected
    plan = from_config(config_path("sim/record"), "shared")
    assert {t.config.can_options["rig"] for t in plan.targets} == {"shared"}
    assert not any("operator" in t.config.can_options for t in plan.targets)  # nobody moves a leader for the doctor
    assert not plan.real


def test_a_config_of_one_arm(tmp_path):
    path = tmp_path / "one.yaml"
    path.write_text(
        "robot: {type: yam_follower, channel: can_x, calibration_dir: /somewhere, use_degrees: true,\n"
        "  cameras: {wrist: {type: opencv, index_or_path: 0}}}\n"
        "teleop: {type: yam_leader, id: me, channel: can_y, calibration_path: stops.json}\n"
    )
    follower, leader = from_config(path, None).targets
    assert follower.calibration == Path("/somewhere/yam/can_x_gripper.json")
    assert leader.config.gripper == "yam_teaching_handle" and leader.calibration == Path("stops.json")


@pytest.mark.parametrize(
    "text", ["robot: {type: so101_follower}", "robot: {type: bi_yam_follower}", "- 1", "robot: {type: yam_follower}"]
)
def test_a_config_without_our_arms(tmp_path, text):
    path = tmp_path / "other.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"other\.yaml|channel"):
        from_config(path, None)


PAIR = "{{type: bi_yam_follower, left_arm_config: &a {{channel: can_l{of_left}}}, right_arm_config: {{<<: *a{right}}}}}"


@pytest.mark.parametrize(
    ("of_left", "right", "text"),
    [
        (", griper: linear_4310", ", channel: can_r", "left_arm_config: there is no option 'griper'; 'gripper'"),
        ("", ", channel: can_r, use_degrees: true", "right_arm_config: there is no option 'use_degrees'"),
        ("", "", "different names and channels"),
        (", identity_path: arm.json", ", channel: can_r", "identity_path of its own.*<<"),
        ("", ", channel: can_r, rate_hz: 200", "same rate_hz"),
    ],
)
def test_what_no_session_starts_with_is_not_healthy(tmp_path, of_left, right, text):
    path = tmp_path / "pair.yaml"
    path.write_text("robot: " + PAIR.format(of_left=of_left, right=right))
    with pytest.raises(ConfigError, match=text):
        from_config(path, None, check_options)


@pytest.mark.parametrize(("name", "arms"), [("real/eval", 2), ("train/lift_and_place_eval", 1)])
def test_the_robot_of_an_evaluation(name, arms):
    assert len(from_config(config_path(name), None).targets) == arms


def test_leaders_without_motors():
    left, right = from_config(config_path("sim/passive_teleoperate"), "shared").targets[2:]
    assert (left.channel, right.channel) == ("leader_left", "leader_right")
    passive = passive_of(left.config)
    assert passive.joint_sign == JOINT_SIGNS["desk"] and left.calibration is None
    expected = calibration_root() / "teleoperators/bi_yam_passive_leader/yam/left_sim_passive.json"
    assert passive.calibration_path == str(expected)
    assert "lerobot-calibrate --teleop.type=bi_yam_passive_leader --teleop.id=sim" in left.calibrate


def test_a_hand_guide_has_no_hardware_of_its_own():
    assert [target.channel for target in from_config(config_path("sim/hand_guide_record"), None).targets] == [
        "follower_left"
    ]


FOLLOWER = "{type: yam_follower, channel: can_x}"
TWO = "{type: bi_yam_follower, left_arm_config: {channel: can_l}, right_arm_config: {channel: can_r}}"


@pytest.mark.parametrize(
    ("robot", "teleop", "text"),
    [
        (
            FOLLOWER,
            "{type: yam_hand_guide, gripper: crank_4310}",
            "gripper is crank_4310, the follower's is linear",
        ),
        (FOLLOWER, "{type: yam_hand_guide, action_space: ee}", "action_space is ee, the follower's is joint"),
        (FOLLOWER, "{type: yam_hand_guide, griper_key: g}", "no option 'griper_key'; 'gripper_key'"),
        (FOLLOWER, "{type: bi_yam_hand_guide}", "two hands guide a bi_yam_follower"),
        (TWO, "{type: bi_yam_hand_guide, arm: big_yam}", "arm is big_yam, the follower's is yam"),
        ("{type: so101_follower}", "{type: yam_hand_guide}", "a hand guides a yam_follower"),
        (FOLLOWER, "{type: yam_passive_leader, channel: can_y, kind: table}", "kind takes one of desk"),
        (FOLLOWER, "{type: yam_passive_leader, channel: can_y, joint_sign: [1]}", "joint_sign takes 1 or -1"),
        (FOLLOWER, "{type: yam_passive_leader, channel: can_y, bilateral: 0.1}", "no option 'bilateral'"),
    ],
)
def test_a_teleoperator_of_which_no_session_would_come(tmp_path, robot, teleop, text):
    path = tmp_path / "run.yaml"
    path.write_text(f"robot: {robot}\nteleop: {teleop}\n")
    with pytest.raises(ConfigError, match=text):
        from_config(path, None, check_options)


def test_calibration_files_lie_where_lerobot_keeps_them(monkeypatch):
    constants = pytest.importorskip("lerobot.utils.constants")
    assert calibration_root() == constants.HF_LEROBOT_CALIBRATION
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", "~/elsewhere")
    assert calibration_root() == Path("~/elsewhere").expanduser()
    for name in ("HF_LEROBOT_CALIBRATION", "HF_LEROBOT_HOME", "HF_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/cache")
    assert calibration_root() == Path("/cache/huggingface/lerobot/calibration")


WHOLE = '{"version": 1, "gripper": "linear_4310", "closed_rad": 3.25, "open_rad": -3.3}'
DAMAGED = {
    "cut off": (WHOLE[:40], "is not a gripper calibration"),
    "another gripper": (WHOLE.replace("linear_4310", "crank_4310"), "was made for gripper 'crank_4310'"),
    "collapsed": (WHOLE.replace("-3.3", "3.17"), "span 0.080 rad"),
    "inverted": (WHOLE.replace("3.25", "-3.25").replace("-3.3}", "3.3}"), "inverted"),
    "a directory": (None, "cannot be read"),
}


def check(tmp_path, option):
    config = tmp_path / "one.yaml"
    config.write_text(f"robot: {{type: yam_follower, channel: can_x, {option}}}")
    section = Section("gripper_calibration")
    check_calibrations(from_config(config, None).targets, tmp_path, section)
    return section


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_calibration_is_a_problem(tmp_path, kind):
    (text, what), path = DAMAGED[kind], tmp_path / "stops.json"
    path.mkdir() if text is None else path.write_text(text)
    (problem,) = check(tmp_path, f"calibration_path: {path}").findings
    assert problem.severity is Severity.PROBLEM and problem.where == "can_x gripper"
    assert what in problem.what
    again = f"lerobot-calibrate --robot.type=yam_follower --robot.channel=can_x --robot.calibration_path={path}"
    assert problem.remedy == f"rm {path} && {again}"


def test_a_good_calibration(tmp_path):
    (tmp_path / "stops.json").write_text(WHOLE)
    section = check(tmp_path, f"calibration_path: {tmp_path / 'stops.json'}")
    (row,) = section.rows
    assert section.findings == [] and row["state"] == "valid"
    assert row["span_rad"] == pytest.approx(6.55) and row["age_days"] < 1


def test_no_calibration_yet_and_stops_in_the_config(tmp_path):
    section = check(tmp_path, f"calibration_path: {tmp_path / 'none.json'}")
    assert [f.severity for f in section.findings] == [Severity.WARNING] and section.rows[0]["state"] == "missing"
    (problem,) = check(tmp_path, "gripper_stops_rad: [3.2, 3.1]").findings
    assert problem.severity is Severity.PROBLEM and "gripper_stops_rad" in problem.remedy


def test_without_a_config_all_files_of_lerobot_are_looked_at(tmp_path):
    directory = tmp_path / "robots" / "yam_follower" / "yam"
    directory.mkdir(parents=True)
    (directory / "a_gripper.json").write_text(WHOLE)
    (directory / "b_gripper.json").write_text("{")
    (directory / "c_gripper.json").write_text(WHOLE.replace("linear_4310", "my_own"))
    section = Section("gripper_calibration")
    check_calibrations([from_option("can_x", "socketcan", None)], tmp_path, section)
    assert [row["state"] for row in section.rows] == ["valid", "unusable", "unknown"]
    assert [f.severity for f in section.findings] == [Severity.PROBLEM, Severity.NOTE]
