"""What gates do is said aloud with LeRobot's own voice, where the command speaks."""

import time
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.state.modes import Gate
from lerobot_teleoperator_yam.yam_leader import GateVoice
from tests.support.lerobot_calls import SCRIPTS, called_by
from tests.support.spoken import Spoken


@pytest.fixture
def spoken(tmp_path, monkeypatch):
    return Spoken(tmp_path, monkeypatch)


def begun(sounds=True, script="lerobot_record.py", together=True):
    """A voice, begun under a command with that option."""
    voice = GateVoice(together)
    config = SimpleNamespace() if sounds is None else SimpleNamespace(play_sounds=sounds)
    called_by(SCRIPTS / script, "record", voice.begin, cfg=config)
    return voice


def test_each_change_is_said_once_and_the_beginning_is_none(spoken):
    voice = begun()
    for gate in (Gate.HOMING, Gate.HOMING, Gate.IDLE, Gate.APPROACH, Gate.ENGAGED, Gate.ENGAGED):
        voice.tell({"left_": gate, "right_": gate})
        time.sleep(0.1)  # a program of its own says each
    assert spoken.lines(3) == ["ready", "approaching", "engaged"]


def test_gates_that_move_together_are_said_together_and_others_by_side(spoken):
    voice = begun()
    for left, right in [(Gate.IDLE, Gate.IDLE), (Gate.APPROACH, Gate.IDLE), (Gate.APPROACH, Gate.APPROACH)]:
        voice.tell({"left_": left, "right_": right})
    assert spoken.lines(1) == ["approaching"]
    voice = begun(together=False)
    for left, right in [(Gate.IDLE, Gate.IDLE), (Gate.APPROACH, Gate.IDLE)]:
        voice.tell({"left_": left, "right_": right})
    assert spoken.lines(2) == ["approaching", "left approaching"]


@pytest.mark.parametrize("sounds", [False, None])
def test_a_command_that_is_silent_or_knows_no_sounds_says_nothing(spoken, sounds):
    voice = begun(sounds)
    for gate in (Gate.IDLE, Gate.APPROACH):
        voice.tell({"": gate})
    begun().tell({"": Gate.IDLE})
    voice.begin()  # a program of the user's
    voice.tell({"": Gate.ENGAGED})
    assert spoken.lines(0) == []
