"""Mistakes in a config: LeRobot's parser prints one line that begins with the cause and says what to do."""

import pickle
import re
import sys

import pytest
from lerobot.configs import parser
from lerobot.scripts.lerobot_record import RecordConfig

from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

MOST = 300  # characters
# LeRobot's words before the cause, by what finds it: the parser, a choice of words, a type that may be none.
BEFORE = re.compile(r"^(error: |lerobot-record: error: |TeleoperatorConfig: |Literal: )")
LEFT, RIGHT = "--robot.left_arm_config.", "--robot.right_arm_config."
LEADER = "--teleop.left_arm_config."

# option, what the line begins with, what it says
MISTAKES = [
    (f"{LEFT}arm=yamm", "left_follower: ", "did you mean 'yam'"),
    (f"{LEFT}gripper=/nowhere/claw.yaml", "left_follower: ", "/nowhere/claw.yaml"),
    (f"{LEFT}channel=", "left_follower: ", "set `channel`"),
    (f"{RIGHT}channel=follower_left", "arms of one robot ", "different names and channels"),
    (f"{RIGHT}rate_hz=200", "arms of one robot ", "same rate_hz"),
    (f"{LEFT}kp=[1,2]", "left_follower: ", "kp"),
    (f"{LEFT}estop_button=top", "left_follower: ", "estop_button"),
    (f"{LEFT}estop_button=middle", "", "top, bottom"),
    (f"{LEFT}start=fly", "", "start"),
    (f"{LEFT}name=", "", "name"),
    ("--robot.action_space=polar", "", "action_space"),
    ("--robot.use_degrees=maybe", "", "use_degrees"),
    (f"{LEFT}cameras={{cup: {{type: opencv, index_or_path: 0}}}}", "camera left_cup: ", "width"),
    (f"{LEADER}ee_gripper=claw", "left_leader: ", "claw"),
    (f"{LEADER}follower_arm=yamm", "left_leader: ", "did you mean 'yam'"),
    (f"{LEADER}gripper=yam_teaching_handel", "left_leader: ", "did you mean 'yam_teaching_handle'"),
    ("--teleop.buttons={next: left_top, stop: left_top}", "bi_yam_leader: button left_top ", "two meanings: next and"),
    ("--teleop.buttons=recrod", "bi_yam_leader: ", "did you mean 'record'"),
    ("--teleop.buttons={nxet: left_top}", "bi_yam_leader: ", "did you mean 'next'"),
    ("--teleop.buttons={next: top}", "bi_yam_leader: ", "left_top"),
    ("--teleop.auto_episodes=maybe", "", "auto_episodes"),
    ("--teleop.auto_episodes=true", "bi_yam_leader: auto_episodes needs a gate", "gate to auto"),
    (f"{LEADER}follower=leader_up", "left_leader: its follower leader_up is no arm", "follower_left, follower_right"),
    ("--teleop.right_arm_config.channel=leader_left", "channel leader_left is given twice, ", "left_arm_config"),
]


def said(monkeypatch, capsys, *arguments):
    """The last line that LeRobot's parser prints before it ends."""
    monkeypatch.setattr(sys, "argv", ["lerobot-record", "--config_path=configs/sim/record.yaml", *arguments])

    @parser.wrap()
    def command(cfg: RecordConfig):
        pytest.fail(f"it was taken: {cfg}")

    with pytest.raises(SystemExit) as end:
        command()
    assert end.value.code not in (0, None)
    return capsys.readouterr().err.strip().splitlines()[-1].strip()


@pytest.mark.parametrize(("option", "begins", "names"), MISTAKES, ids=[row[0] for row in MISTAKES])
def test_a_mistake_is_one_line_that_begins_with_the_cause(monkeypatch, capsys, option, begins, names):
    line = said(monkeypatch, capsys, option)
    cause = BEFORE.sub("", line)
    assert cause.startswith(begins) and names in cause and len(line) < MOST, line


def test_a_command_that_names_what_is_not_there_is_a_line_too(monkeypatch, capsys, tmp_path):
    line = said(monkeypatch, capsys, f"--dataset.root={tmp_path}")
    assert line == f"error: {tmp_path} is there already and is no data set; choose another dataset.root"


def test_a_button_of_two_options_is_a_mistake(monkeypatch, capsys):
    line = said(monkeypatch, capsys, f"{LEADER}estop_button=top", "--teleop.buttons=record")
    assert "button left_top has two meanings: estop_button and rerecord; give it one" in line
    led = (f"{LEADER}follower=follower_left", f"{LEADER}fine_button=bottom")
    assert "left_bottom has two meanings: fine_button and next" in said(
        monkeypatch, capsys, *led, "--teleop.buttons=record"
    )


def test_a_refusal_comes_through_a_pipe():
    error = pickle.loads(pickle.dumps(RefusedConfigError("left_follower: kp takes 6 numbers")))
    assert str(error) == "left_follower: kp takes 6 numbers"


def test_the_config_as_it_is_shipped_is_taken(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["lerobot-record", "--config_path=configs/sim/record.yaml"])

    @parser.wrap()
    def command(cfg: RecordConfig):
        return cfg

    assert command().robot.type == "bi_yam_follower"
