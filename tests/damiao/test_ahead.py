"""Commands that go out while the last reply to those before is still on the wire."""

import time

import numpy as np
import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.encoder import HandleEncoder
from lerobot_robot_yam.damiao.motor_spec import MotorSpec

from .desk_bus import DeskBus

SPECS = [MotorSpec(f"joint{i + 1}", i + 1, kind) for i, kind in enumerate(["DM4340"] * 3 + ["DM4310"] * 4)]
STEP_RAD = 25.0 / 65535  # one code of the position
LATER_S = 3600.0  # who waits so long has failed


@pytest.fixture
def bus():
    with DeskBus(SPECS, handle=True) as desk:
        yield desk


@pytest.fixture
def chain(bus):
    return MotorChain(bus, SPECS, channel="desk")


def send(chain, q):
    table = np.zeros((7, 5))
    table[:, 0] = q
    chain.send(table)


def collect_ahead(chain, wait_s=0.0):
    return chain.collect(time.monotonic() + wait_s, ahead=1)


def test_the_last_reply_is_collected_after_the_next_commands_have_gone_out(bus, chain):
    bus.late.add(7)
    for q in (0.1, 0.2, 0.3):
        send(chain, q)
        bus.release()  # the last reply to those before
        assert collect_ahead(chain, LATER_S)
        chain.await_all_but_one(time.monotonic() + LATER_S)
    assert len(bus.sent) == 21
    np.testing.assert_allclose(chain.position_rad, 0.2, atol=2 * STEP_RAD)
    bus.release()
    assert chain.collect(time.monotonic() + LATER_S) and chain.all_answered
    np.testing.assert_allclose(chain.position_rad, 0.3, atol=2 * STEP_RAD)
    assert not chain.lost.any() and not chain.duplicates.any()


def test_nothing_is_collected_ahead_of_the_first_commands(bus, chain):
    bus.silent.update(range(1, 8))
    send(chain, 0.1)
    assert collect_ahead(chain, LATER_S)
    assert not chain.lost.any()
    assert not chain.collect(time.monotonic()) and not chain.all_answered
    assert chain.lost.tolist() == [1] * 7


def test_a_reply_that_never_comes_is_lost_once(bus, chain):
    bus.silent.add(3)
    send(chain, 0.1)
    chain.await_all_but_one(time.monotonic() + LATER_S)  # does not wait for it
    send(chain, 0.2)
    assert not collect_ahead(chain) and not chain.all_answered
    assert chain.lost.tolist() == [0, 0, 1, 0, 0, 0, 0]
    assert not chain.collect(time.monotonic())
    bus.silent.clear()
    send(chain, 0.3)
    assert chain.collect(time.monotonic()) and chain.all_answered
    assert chain.lost.tolist() == [0, 0, 2, 0, 0, 0, 0]
    assert chain.position_rad[2] == pytest.approx(0.3, abs=2 * STEP_RAD)


def test_two_replies_that_are_missing_are_waited_for(bus, chain):
    bus.silent.update((3, 4))
    send(chain, 0.1)
    before = time.monotonic()
    chain.await_all_but_one(before + 0.02)
    assert time.monotonic() - before >= 0.02


def test_a_motor_that_answers_twice_is_noticed_and_puts_nobody_behind(bus, chain):
    bus.doubled.update(range(1, 8))
    for q in np.linspace(0.0, 1.0, 20):
        send(chain, q)
        collect_ahead(chain)
        chain.await_all_but_one(time.monotonic())
    assert chain.duplicates.min() > 10
    send(chain, 1.1)
    chain.collect(time.monotonic())
    chain.collect(time.monotonic())
    np.testing.assert_allclose(chain.position_rad, 1.1, atol=0.06)  # at most one tick old


def test_a_silent_handle_is_counted_and_not_waited_for(bus):
    handle = HandleEncoder()
    chain = MotorChain(bus, SPECS, channel="desk", encoder=handle)
    send(chain, 0.0)
    chain.await_all_but_one(time.monotonic() + LATER_S)
    bus.handle = False
    send(chain, 0.0)
    assert collect_ahead(chain, LATER_S)
    assert handle.lost == 0
    for number in (1, 2, 3):
        send(chain, 0.0)
        assert collect_ahead(chain, LATER_S if number > 2 else 0.0)  # both that were sent while it answered
        assert handle.lost == number


def test_a_question_collects_what_is_open_first(bus, chain):
    bus.late.update(range(1, 8))
    send(chain, 0.1)
    send(chain, 0.2)
    bus.late.clear()
    bus.release()
    bus.silent.add(1)
    assert chain.refresh(timeout_s=0.005) == [False] + [True] * 6
    assert chain.all_answered and not chain.lost.any()
