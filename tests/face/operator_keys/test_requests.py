"""Who does what a page asks for: a leader's keys before a follower's, a referee, a strategy that takes arms over."""

import threading
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.face import referee
from lerobot_robot_yam.face.lerobot_command.running_command import AGAIN, RECORD, Meaning, Phase, Situation
from lerobot_robot_yam.face.operator_keys import operator_keys, requests
from lerobot_robot_yam.face.operator_keys.operator_keys import OperatorKeys
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_robot_yam.face.referee import OperatorReferee, Verdict
from lerobot_strategy_yam.take_over import TakeOverSignals
from lerobot_teleoperator_yam.yam_leader import BiYamLeader
from tests.face.operator_keys.test_key_plan import recording
from tests.strategy.test_config import leading
from tests.support.strategy_here import HereConfig
from tests.support.waiting import wait


@pytest.fixture(autouse=True)
def nobody_is_left():
    """One left behind would answer the page in a later test of this process."""
    yield
    left, requests._doers[:] = [*requests._doers], []
    assert left == []


@pytest.fixture
def command(monkeypatch):
    """A situation that the test sets, and the keys that were pressed in it."""
    pressed = []
    state = SimpleNamespace(now=Situation(), pressed=pressed)

    def look():
        return state.now

    monkeypatch.setattr(operator_keys.running_command, "hears_keys", lambda: True)
    monkeypatch.setattr(operator_keys.running_command, "look", look)
    return state


def during(command, **fields):
    """A policy's rollout with a key that saves."""
    keys = {Meaning.SAVE: lambda: command.pressed.append("s")}
    command.now = Situation(RECORD, Phase.AUTONOMOUS, keys, **fields)


def test_a_followers_keys_do_what_the_listener_does(command):
    keys = OperatorKeys({}, auto=False, by_request=True)
    during(command)
    keys.start(dict)
    assert requests.ask(Press("a page", Meaning.SAVE))
    wait(lambda: command.pressed == ["s"])
    keys.stop()
    assert not requests.ask(Press("a page", Meaning.SAVE)) and requests.offers(command.now, 0) == {}


def test_a_leaders_keys_come_first(command):
    """They know whether episodes are automatic."""
    follower, leader = OperatorKeys({}, auto=False, by_request=True), OperatorKeys({"top": Meaning.NEXT}, auto=False)
    during(command)
    follower.start(dict)
    leader.start(dict)
    assert requests._doers == [leader, follower]
    leader.stop()
    requests.ask(Press("a page", Meaning.SAVE))
    wait(lambda: command.pressed == ["s"])
    follower.stop()


def test_what_is_for_a_phase_that_is_over_does_nothing(command, caplog):
    keys = OperatorKeys({}, auto=False, by_request=True)
    during(command, turn=2.0)
    keys.start(dict)
    requests.ask(Press("a page", Meaning.SAVE, turn=1.0))
    wait(lambda: "came too late" in caplog.text)
    requests.ask(Press("a page", Meaning.SAVE, turn=2.0))
    wait(lambda: command.pressed == ["s"])
    keys.stop()


def test_who_is_asked_for_nothing_rescues_nothing(command, tmp_path):
    """A recording without leaders' buttons goes on as LeRobot has it, as long as no page asks for anything."""
    keys = OperatorKeys({}, auto=False, by_request=True)
    command.now = recording(Phase.RESETTING, frames=0)
    command.now.dataset.root = tmp_path
    for now_s in range(1, 5):
        keys._tick(float(now_s), {})
    assert command.pressed == [] and command.now.flags == {AGAIN: False}


def test_a_referee_is_told_by_the_page(monkeypatch):
    monkeypatch.setattr(referee, "create_key_listener", lambda *_, **__: SimpleNamespace(stop=lambda: None))
    person = OperatorReferee("stack the cups")
    laid_out = threading.Thread(target=person.arrange, args=(None,))
    laid_out.start()
    wait(lambda: set(requests.offers(Situation(), 0)) == {"next"})
    requests.ask(Press("a page", Meaning.SUCCESS))  # not yet
    requests.ask(Press("a page", Meaning.NEXT))
    laid_out.join(30.0)
    assert not laid_out.is_alive() and set(requests.offers(Situation(), 0)) == {"success", "failure"}
    assert person.verdict({}) == Verdict(False, False)
    requests.ask(Press("a page", Meaning.FAILURE))
    assert person.verdict({}) == Verdict(False, True)
    person.close()
    assert not requests.ask(Press("a page", Meaning.SUCCESS))
    seeds = []
    beside_rig = OperatorReferee("stack the cups", SimpleNamespace(arrange=seeds.append, close=lambda: None))
    beside_rig.arrange(7)  # a rig asks nobody
    beside_rig.close()
    assert seeds == [7]


def test_a_strategy_that_takes_arms_over_is_asked_by_its_keys(tmp_path):
    signals = TakeOverSignals(BiYamLeader(leading(tmp_path)), HereConfig())
    requests.join(signals, first=True)
    offered = requests.offers(Situation(), 0)
    for meaning in (Meaning.DISCARD, Meaning.SAVE, Meaning.STOP):
        requests.ask(Press("a page", meaning))
    requests.leave(signals)
    assert set(offered) == {"correct", "next", "discard", "stop"} and list(signals._keys) == ["x", "esc"]
