"""Which command an answer belongs to, on a channel that keeps its order and may take any time or lose anything."""

import random

import pytest

from lerobot_robot_yam.damiao.reply_matching import Requests

TICK_S = 0.004
MOTORS = 7


class Channel:
    """Answers come in the order of the questions, each `delay_s` after its own; `release_s` holds all back until then.

    Checks that no answer is ever taken for one to a newer question, and counts those taken for one to an older.
    """

    def __init__(self, motors=MOTORS):
        self.requests = Requests(motors)
        self.now = 0.0
        self.delay_s = 0.002
        self.release_s = 0.0
        self.under_way = []  # (when it arrives, motor, number of the question that it answers)
        self.too_old = 0
        self.left_out = self.unasked = 0
        self.asked = [0] * motors
        self._last_s = 0.0

    def tick(self, lost=lambda motor: False):
        end = self.now + TICK_S
        absent = self.requests.absent()
        self.left_out += len(absent)
        request = self.requests.begin([i for i in range(len(self.requests.lost)) if i not in absent], False, 1)
        for motor in sorted(request.motors):
            self.asked[motor] += 1
            if not lost(motor):
                self._last_s = max(self._last_s, self.now + self.delay_s + 1e-5 * motor)
                self.under_way.append((self._last_s, motor, request.number))
        self.too_old = 0
        while self.under_way and max(self.under_way[0][0], self.release_s) < end:
            _, motor, number = self.under_way.pop(0)
            found = self.requests.answer(motor)
            assert found is not None, "an answer to a question was taken for one to none"
            assert found.number <= number, "an old answer was taken for a fresh one"
            self.too_old += found.number < number
        self.now = end

    def ticks(self, count, lost=lambda motor: False):
        for _ in range(count):
            self.tick(lost)

    def settled(self):
        """No motor is left out any more, and every answer counts for what it is."""
        self.ticks(700)
        left_out = self.left_out
        self.ticks(50)
        return self.too_old == 0 and self.left_out == left_out


@pytest.mark.parametrize("delay_ms", [0.5, 2.0, 3.999, 4.0, 12.0, 42.0, 82.0])
def test_any_delay(delay_ms):
    channel = Channel()
    channel.delay_s = delay_ms / 1e3
    for _ in range(1000):
        channel.tick()
        assert channel.too_old == 0
    assert not any(channel.requests.lost)


def test_frames_that_are_held_back():
    channel = Channel()
    for start in range(20):
        channel.ticks(10 + start)
        channel.release_s = channel.now + random.Random(start).uniform(0.005, 0.09)
        for _ in range(25):
            channel.tick()
            assert channel.too_old == 0
    assert not any(channel.requests.lost) and channel.left_out == 0


def test_a_channel_that_becomes_slower_and_quicker_again():
    channel = Channel()
    for delay_ms in (2.0, 42.0, 10.0, 82.0, 6.0, 2.0):
        channel.delay_s = delay_ms / 1e3
        for _ in range(300):
            channel.tick()
            assert channel.too_old == 0
    assert not any(channel.requests.lost)


@pytest.mark.parametrize("delay_ms", [2.0, 6.0, 42.0])
@pytest.mark.parametrize("motor", range(MOTORS))
def test_one_answer_is_lost(motor, delay_ms):
    channel = Channel()
    channel.delay_s = delay_ms / 1e3
    channel.ticks(300)
    channel.tick(lost=lambda i: i == motor)
    channel.ticks(60)
    assert channel.too_old == 0
    assert channel.requests.lost == [int(i == motor) for i in range(MOTORS)]


@pytest.mark.parametrize("delay_ms", [2.0, 6.0, 42.0])
@pytest.mark.parametrize("ticks", [1, 2, 9, 30])
@pytest.mark.parametrize("motors", [1, 2, 3, 7])
def test_whole_ticks_are_lost(ticks, delay_ms, motors):
    channel = Channel(motors)
    channel.delay_s = delay_ms / 1e3
    channel.ticks(300)
    channel.ticks(ticks, lost=lambda _: True)
    channel.ticks(1)
    assert channel.settled()
    assert channel.requests.lost == [ticks] * motors


@pytest.mark.parametrize("ticks", [4, 5, 15, 25])
def test_a_silence_of_the_channel_is_over_some_ticks_after_it_replies_again(ticks):
    """Else an arm would be led by old samples for 0.3 s, and then lose the motor that rests for that long."""
    channel = Channel()
    channel.ticks(300)
    channel.ticks(ticks, lost=lambda _: True)
    channel.ticks(11)
    assert channel.too_old == 0 and channel.left_out <= 7


@pytest.mark.parametrize("losses", [1, 3])
@pytest.mark.parametrize("after_ticks", range(45, 75, 3))
def test_a_channel_that_becomes_slower_and_loses_answers_while_that_is_found_out(after_ticks, losses):
    channel = Channel()
    channel.ticks(100)
    channel.delay_s = 0.042
    channel.ticks(after_ticks)
    channel.ticks(losses, lost=lambda motor: motor == 0)
    assert channel.settled()


@pytest.mark.parametrize("motors", [1, 7])
def test_no_motor_goes_without_commands_for_long_while_nothing_is_heard(motors):
    """Commands may arrive all the same, and a motor without them lets go after 0.4 s."""
    channel = Channel(motors)
    channel.ticks(300)
    for _ in range(1000):
        before = channel.asked[0]
        channel.tick(lost=lambda _: True)
        channel.unasked = channel.unasked + 1 if channel.asked[0] == before else 0
        assert channel.unasked <= 32
    assert channel.settled()


@pytest.mark.parametrize("seed", range(20))
def test_losses_now_and_then(seed):
    chance = random.Random(seed)
    channel = Channel()
    channel.delay_s = chance.choice([0.002, 0.006, 0.02])
    for _ in range(300):
        share = chance.choice([0.0, 0.0, 0.05, 0.3])
        channel.tick(lost=lambda _, share=share: chance.random() < share)
    assert channel.settled()


def test_an_answer_to_no_question_counts_as_a_duplicate():
    requests = Requests(2)
    requests.begin([0, 1], False, 1)
    assert requests.answer(0) is requests.newest
    assert requests.answer(0) is None
    assert requests.duplicates == [1, 0]
