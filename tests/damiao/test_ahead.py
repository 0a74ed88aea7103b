"""Commands that go out while the last reply to those before is still on the wire."""

import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao.chain import LAST_REPLY_S, MotorChain
from lerobot_robot_yam.damiao.encoder import HandleEncoder
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S
from lerobot_robot_yam.errors import BusError

from .desk_bus import SPECS

STEP_RAD = 25.0 / 65535  # one code of the position
LATER_S = 3600.0  # who waits so long has failed


@pytest.fixture
def chain(chain):
    """It is in step, as a loop's is after its first tick."""
    send(chain, 0.0)
    chain.await_all_but_one(time.monotonic())
    return chain


def send(chain, q):
    table = np.zeros((7, 5))
    table[:, 0] = q
    chain.send(table)


def await_all_but_one(chain, wait_s=LATER_S):
    chain.await_all_but_one(time.monotonic() + wait_s)


def test_the_last_reply_is_collected_after_the_next_commands_have_gone_out(bus, chain):
    bus.late.update(range(1, 8))
    send(chain, 0.1)
    for q in (0.2, 0.3, 0.4):
        bus.release(6)
        await_all_but_one(chain)
        send(chain, q)
        bus.release(1)
        assert chain.collect_earlier() and chain.all_answered
        np.testing.assert_allclose(chain.position_rad, q - 0.1, atol=2 * STEP_RAD)
    bus.release()
    assert chain.collect(time.monotonic())
    np.testing.assert_allclose(chain.position_rad, 0.4, atol=2 * STEP_RAD)
    assert not chain.lost.any() and not chain.duplicates.any()


def test_nothing_is_collected_before_the_first_commands(bus, chain):
    bus.silent.update(range(1, 8))
    send(chain, 0.1)
    assert chain.collect_earlier()
    assert not chain.lost.any()
    assert not chain.collect(time.monotonic()) and not chain.all_answered
    assert chain.lost.tolist() == [1] * 7


def test_a_reply_that_never_comes_is_lost_once_and_holds_up_one_tick(bus, chain):
    bus.silent.add(3)
    send(chain, 0.1)
    await_all_but_one(chain)  # does not wait for it
    bus.silent.clear()
    send(chain, 0.2)
    assert chain.collect_earlier()  # by the answer to these, which came too soon for a wire
    before = time.monotonic()
    await_all_but_one(chain, 0.02)
    assert time.monotonic() - before >= 0.02
    assert chain.lost.tolist() == [0, 0, 1, 0, 0, 0, 0] and not chain.all_answered
    send(chain, 0.3)
    await_all_but_one(chain, 0.02)
    send(chain, 0.4)
    await_all_but_one(chain)
    assert chain.all_answered
    assert chain.lost.tolist() == [0, 0, 1, 0, 0, 0, 0] and not chain.duplicates.any()


def test_the_wait_for_a_last_reply_is_longer_than_a_frame_and_shorter_than_a_question_and_its_answer(bus, chain):
    assert FRAME_TIME_S < LAST_REPLY_S < 2 * 111e-6
    bus.late.add(1)
    send(chain, 0.1)
    await_all_but_one(chain)
    send(chain, 0.2)
    before = time.monotonic()
    assert not chain.collect_earlier()
    assert LAST_REPLY_S / 2 < time.monotonic() - before < 1.0  # of a machine that is busy elsewhere
    assert chain.lost[0] == 1


def test_a_reply_that_comes_after_all_puts_nobody_behind(bus, chain):
    bus.late.add(7)
    send(chain, 0.1)
    await_all_but_one(chain)
    send(chain, 0.2)
    assert not chain.collect_earlier()
    bus.late.clear()
    bus.release()  # both, too late
    for q in (0.3, 0.4):
        await_all_but_one(chain, 0.01)
        send(chain, q)
        assert chain.collect_earlier()
    await_all_but_one(chain)
    assert len(bus._queue) == 1  # the last one to the newest commands: no older one was taken for it
    assert chain.lost.tolist() == [0, 0, 0, 0, 0, 0, 1] and not chain.duplicates.any()


def test_two_replies_that_are_missing_are_waited_for(bus, chain):
    bus.silent.update((3, 4))
    send(chain, 0.1)
    before = time.monotonic()
    await_all_but_one(chain, 0.02)
    assert time.monotonic() - before >= 0.02


def test_a_motor_that_answers_twice_is_noticed_and_puts_nobody_behind(bus, chain):
    bus.doubled.update(range(1, 8))
    for q in np.linspace(0.0, 1.0, 20):
        send(chain, q)
        chain.collect_earlier()
        await_all_but_one(chain, 0.001)
    assert chain.duplicates.min() > 10
    np.testing.assert_allclose(chain.position_rad, 1.0, atol=2 * STEP_RAD)


def test_with_a_handle_everything_is_collected_first(bus):
    handle = HandleEncoder()
    chain = MotorChain(bus, SPECS, channel="desk", encoder=handle)
    for _ in range(3):
        send(chain, 0.0)
        await_all_but_one(chain, 0.001)
        assert not bus._queue and chain.all_answered
    assert handle.stamp_s > 0 and handle.lost == 0


def test_what_an_error_has_left_open_is_not_waited_for(bus, chain, monkeypatch):
    def gone(message, timeout=None):
        raise can.CanOperationError("no such device")

    with monkeypatch.context() as unplugged:
        unplugged.setattr(chain._port, "_send_one", gone)
        with pytest.raises(BusError):
            send(chain, 0.1)
    send(chain, 0.2)
    assert chain.collect(time.monotonic()) and not chain.lost.any()
