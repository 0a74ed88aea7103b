"""How the thread that presses keys ends, whatever hangs or fails in it."""

import threading
import time
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.face.lerobot_command.running_command import Meaning
from lerobot_robot_yam.face.operator_keys import operator_keys
from lerobot_robot_yam.face.operator_keys.operator_keys import OperatorKeys
from lerobot_teleoperator_yam.yam_leader import LeaderBase


@pytest.fixture(autouse=True)
def hears(monkeypatch):
    monkeypatch.setattr(operator_keys.running_command, "hears_keys", lambda: True)


@pytest.fixture
def keys():
    return OperatorKeys({"top": Meaning.NEXT}, auto=False)


def test_a_thread_that_hangs_holds_nobody_up_and_presses_nothing_later(keys, monkeypatch):
    monkeypatch.setattr(operator_keys, "_END_S", 0.05)
    answers, calls = threading.Event(), []

    def hang():
        calls.append(1)
        answers.wait(60.0)
        return {}

    keys.start(hang)
    thread = keys._thread
    while not calls:
        time.sleep(0.001)
    began_s = time.monotonic()
    keys.stop()
    assert time.monotonic() - began_s < 30.0
    keys.start(dict)  # the next session does not wake it
    answers.set()
    thread.join(30.0)
    assert not thread.is_alive() and len(calls) == 1
    keys.stop()
    keys.stop()


def test_a_leader_lands_before_anything_that_could_hang():
    done = []

    def land():
        done.append("land")
        raise OSError("a bus is gone")

    leader = SimpleNamespace(
        _keys=SimpleNamespace(end=lambda: done.append("no key"), stop=lambda: done.append("labels")),
        _arms=SimpleNamespace(stop=land),
        _events=SimpleNamespace(stop=lambda: done.append("no event")),
    )
    with pytest.raises(OSError):
        LeaderBase.disconnect(leader)
    assert done == ["no key", "land", "no event", "labels"]
