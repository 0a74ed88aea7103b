"""yam-setup --check: mistakes in a file that was written by hand, each with what may have been meant."""

import copy

import pytest
import yaml

from lerobot_robot_yam.commands.setup import main
from tests.support.paths import ROOT

GOOD = {
    "robot": {
        "type": "bi_yam_follower",
        "id": "lab",
        "left_arm_config": {"channel": "can_follower_l"},
        "right_arm_config": {"channel": "can_follower_r"},
        "cameras": {"top": {"type": "yam_sim", "camera": "top"}},
    },
    "teleop": {
        "type": "bi_yam_leader",
        "id": "lab",
        "left_arm_config": {"channel": "can_leader_l"},
        "right_arm_config": {"channel": "can_leader_r"},
    },
}
LEFT = ("robot", "left_arm_config")
MISTAKES = {
    "part": ((), {"robots": {}}, "there is no part 'robots'; 'robot'?"),
    "type": (("robot",), {"type": "bi_yam_folower"}, "robot: there is no type 'bi_yam_folower'; 'bi_yam_follower'?"),
    "no type": ((), {"robot": {"id": "lab"}}, "robot: it has no type, such as bi_yam_follower"),
    "type of a leader": (("teleop",), {"type": None}, "teleop: there is no type 'None'"),
    "option of the robot": (("robot",), {"camera": {}}, "robot: there is no option 'camera'; 'cameras'?"),
    "option": (LEFT, {"chanel": "x"}, "robot, left_arm_config: there is no option 'chanel'; 'channel'?"),
    "arm": (LEFT, {"arm": "yam_por"}, "unknown arm 'yam_por'; did you mean 'yam_pro'?"),
    "value": (LEFT, {"kp": [1, 2]}, "kp"),
    "unit": (LEFT, {"rate_hz": 25}, "rate_hz"),
    "channel of two followers": (LEFT, {"channel": "can_follower_r"}, "different names and channels"),
    "channel of a leader": (LEFT, {"channel": "can_leader_r"}, "channel can_leader_r is named twice"),
    "camera": (("robot", "cameras"), {"wrist": {"type": "opencw"}}, "Couldn't find a choice class for 'opencw'"),
    "pair": (LEFT, {"gripper": "no_gripper"}, "left_gripper.pos; set ee_gripper of the leader's arm"),
}


@pytest.fixture
def check(tmp_path, monkeypatch, capsys):
    """Checks a document; returns the exit status and what is said."""
    monkeypatch.chdir(tmp_path)

    def checked(document):
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump(document))
        status = main(["--check"])
        return status, "".join(capsys.readouterr())

    return checked


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_with_its_place(check, mistake):
    keys, change, says = MISTAKES[mistake]
    document = copy.deepcopy(GOOD)
    place = document
    for key in keys:
        place = place[key]
    place |= change
    status, said = check(document)
    assert status == 1 and says in said and said.count("\n") <= 2, said
    assert "rig.yaml" in said


def test_a_good_file_is_told_in_words(check):
    assert check(GOOD) == (
        0,
        "robot: bi_yam_follower, can_follower_l, can_follower_r\n"
        "teleop: bi_yam_leader, can_leader_l, can_leader_r\n"
        "cameras: top\n"
        "rig.yaml has no mistakes; yam-doctor looks at the arms\n",
    )


def test_a_file_that_is_none(check, tmp_path, capsys):
    assert main(["--check", str(tmp_path / "none.yaml")]) == 1
    assert "cannot read" in capsys.readouterr().err
    assert check({"teleop": GOOD["teleop"]})[1].endswith("rig.yaml has no robot: the followers are missing\n")


def test_the_page_shows_a_message_as_it_is(check):
    document = copy.deepcopy(GOOD)
    document["robot"]["left_arm_config"]["chanel"] = "x"
    assert check(document)[1] in (ROOT / "docs/setup.md").read_text()
