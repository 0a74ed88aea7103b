"""How the thread that presses keys ends, whatever hangs or fails in it."""

import threading
import time
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.face.operator_keys import operator_keys
from lerobot_robot_yam.face.operator_keys.meanings import Meaning
from lerobot_robot_yam.face.operator_keys.operator_keys import OperatorKeys
from lerobot_teleoperator_yam.yam_leader import LeaderBase


class Way:
    """A keyboard without keys."""

    def __init__(self):
        self.taken = 0

    def take(self):
        self.taken += 1

    def give_back(self):
        self.taken -= 1


@pytest.fixture
def way(monkeypatch):
    way = Way()
    monkeypatch.setattr(operator_keys, "keyboard", lambda: way)
    monkeypatch.setattr(operator_keys.running_command, "hears_keys", lambda frame: True)
    return way


@pytest.fixture
def keys():
    return OperatorKeys({"top": Meaning.NEXT}, auto=False)


def test_it_gives_back_what_it_took_and_may_begin_again(way, keys):
    for _ in range(2):
        keys.start(None, dict)
        assert way.taken == 1
        keys.stop()
        keys.stop()
        assert way.taken == 0


def test_a_display_that_does_not_answer_holds_nobody_up(way, keys, monkeypatch, caplog):
    monkeypatch.setattr(operator_keys, "_END_S", 0.05)
    answers, calls = threading.Event(), []

    def hang():
        calls.append(1)
        answers.wait(60.0)
        return {}

    keys.start(None, hang)
    thread = keys._thread
    while not calls:
        time.sleep(0.001)
    began_s = time.monotonic()
    keys.stop()
    assert time.monotonic() - began_s < 30.0 and "does not answer" in caplog.text
    keys.start(None, dict)  # the next session does not wake it
    answers.set()
    thread.join(30.0)
    assert not thread.is_alive() and len(calls) == 1
    keys.stop()


def test_labels_that_fail_do_not_keep_the_terminal(way, keys, monkeypatch):
    def fail():
        raise RuntimeError("no such data set")

    keys.start(None, dict)
    monkeypatch.setattr(keys._book, "close", fail)
    with pytest.raises(RuntimeError):
        keys.stop()
    assert way.taken == 0


def test_a_leader_lands_before_anything_that_could_hang():
    done = []

    def land():
        done.append("land")
        raise OSError("a bus is gone")

    leader = SimpleNamespace(
        _keys=SimpleNamespace(end=lambda: done.append("no key"), stop=lambda: done.append("terminal")),
        _arms=SimpleNamespace(stop=land),
        _events=SimpleNamespace(stop=lambda: done.append("no event")),
    )
    with pytest.raises(OSError):
        LeaderBase.disconnect(leader)
    assert done == ["no key", "land", "no event", "terminal"]
