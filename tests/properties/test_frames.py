"""Any frame may come, in any order, at any time: state stays finite, and no frame counts for the wrong motor."""

import math
import time

import can
import numpy as np
import pytest
from hypothesis import strategies as st

from lerobot_robot_yam.damiao import handle_check, handle_encoder
from lerobot_robot_yam.damiao.bus_port import BusPort
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.handle_check import prepare_handle
from lerobot_robot_yam.damiao.handle_encoder import (
    EVENT_ID,
    FIRMWARE_REQUIRED,
    HANDLE_IDS,
    REPORT_ID,
    REQUEST_ID,
    HandleEncoder,
)
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.receiver import FeedbackStore
from lerobot_robot_yam.damiao.registers import decode_reply
from lerobot_robot_yam.damiao.tables import MOTOR_TYPES
from lerobot_robot_yam.errors import MotorError
from tests.support.cases import finite, for_all
from tests.support.desk_bus import encode_feedback
from tests.support.frames import SPECS, NoisyBus, impostors, is_classic_data, messages


def owner(message):
    """Number of the motor whose answer this is, by the book; None if it is nobody's."""
    if not is_classic_data(message) or len(message.data) != 8:
        return None
    if message.data[0] < 0x10 and decode_reply(bytes(message.data)) is not None:
        return None  # a register's answer, for somebody who has asked
    for index, spec in enumerate(SPECS):
        if message.arbitration_id == spec.feedback_id and message.data[0] & 0xF == spec.can_id & 0xF:
            return index
    return None


@for_all(short=60, frames=st.lists(messages(), min_size=1, max_size=12))
def test_a_frame_counts_for_its_motor_or_for_nobody(frames):
    encoder_ = HandleEncoder()
    with NoisyBus(SPECS) as bus:
        chain = MotorChain(bus, SPECS, channel="desk", encoder=encoder_)
        model = FeedbackStore([spec.type for spec in SPECS], [spec.turns for spec in SPECS])
        bus.silent = {spec.can_id for spec in SPECS}
        before = time.monotonic()
        chain.send(np.zeros((len(SPECS), 5)))
        answers, foreign, commands, errors = [0] * len(SPECS), 0, 0, 0
        for message in frames:
            bus.deliver(message)
            index = owner(message)
            on_handle = message.arbitration_id in HANDLE_IDS and is_classic_data(message)
            if message.is_error_frame:
                errors += 1
            elif index is not None:
                answers[index] += 1
                if answers[index] == 1:  # the question's; the others are nobody's
                    model.take(index, message.data, 0.0, 0.0, 0.0, 0.0)
            elif not on_handle:
                foreign += 1
                commands += is_classic_data(message) and message.arbitration_id in {s.can_id for s in SPECS}
        chain.drain()
        now = time.monotonic()
        chain.feedback.publish()
        model.publish()
        for name in ("position_rad", "velocity_rad_s", "torque_nm", "temp_mos_c", "temp_rotor_c", "fault"):
            np.testing.assert_array_equal(getattr(chain, name), getattr(model, name), err_msg=name)
            assert np.isfinite(getattr(chain, name)).all(), name
        heard = np.isfinite(chain.stamp_s)
        assert heard.tolist() == [count > 0 for count in answers]
        assert np.all((chain.asked_s[heard] >= before) & (chain.asked_s[heard] <= chain.stamp_s[heard]))
        assert np.all(chain.stamp_s[heard] <= now)
        assert chain.duplicates.tolist() == [max(0, count - 1) for count in answers]
        assert not chain.lost.any()
        assert sum(chain.foreign.values()) == foreign
        assert (chain.foreign_commands, chain.error_frames) == (commands, errors)
        reports = [
            m for m in frames if is_classic_data(m) and m.arbitration_id in (REPORT_ID, EVENT_ID) and len(m.data) == 6
        ]
        assert math.isfinite(encoder_.stamp_s) == bool(reports)
        if reports:
            assert encoder_.report == handle_encoder.decode_report(reports[-1].data)


@for_all(
    short=60, frames=st.lists(messages(), min_size=1, max_size=8), silent=st.sets(st.sampled_from(range(len(SPECS))))
)
def test_stray_frames_answer_no_request_of_a_silent_motor(frames, silent):
    with NoisyBus(SPECS) as bus:
        chain = MotorChain(bus, SPECS, channel="desk")
        bus.silent = {SPECS[i].can_id for i in silent}
        chain.send(np.zeros((len(SPECS), 5)))
        for message in frames:
            bus.deliver(message)
        answered = {owner(message) for message in frames} | (set(range(len(SPECS))) - silent)
        whole = chain.collect(time.monotonic())
        assert whole == answered.issuperset(range(len(SPECS)))
        assert chain.missed.tolist() == [int(i not in answered) for i in range(len(SPECS))]


@for_all(stamp=st.floats(), timestamp_now=st.booleans(), late=st.floats(-2.0, 2.0))
def test_an_arrival_lies_within_the_last_second(stamp, timestamp_now, late):
    with NoisyBus(SPECS) as bus:
        port = BusPort(bus, "desk")
        stamp = time.time() - late if timestamp_now else stamp
        message = can.Message(timestamp=stamp, arbitration_id=0x11, is_extended_id=False, data=bytes(8))
        before = time.monotonic()
        arrival = port.arrival_s(message)
        assert before - 1.001 <= arrival <= time.monotonic()


# many ticks


def quantum(kind):
    """What a feedback frame rounds positions to, rad."""
    return 2 * MOTOR_TYPES[kind].position_max_rad / 65535


TICK = st.fixed_dictionaries(
    {
        "step": st.lists(st.floats(-0.002, 0.002), min_size=3, max_size=3),  # rad; within a joint's reach at any moment
        "fate": st.lists(
            st.sampled_from(["ok", "ok", "ok", "lost", "late", "twice", "garbled"]), min_size=3, max_size=3
        ),
        "release": st.booleans(),
        "garbage": st.binary(min_size=6, max_size=6),
    }
)
WALKERS = [MotorSpec("a", 1, "DM4340"), MotorSpec("b", 2, "DM4310"), MotorSpec("c", 3, "DM3507")]
REACH_RAD = 1.0  # garbage may look like an answer, but only like one of where the joint could have got


class WalkingBus(NoisyBus):
    """Motors that are where `truth` says, whatever they are told; 4 ms pass from tick to tick."""

    class Ticks:
        now_s = 0.0

        def now(self):
            return self.now_s

        def sleep(self, seconds):
            pass

    def __init__(self, specs):
        super().__init__(specs)
        self.clock = self.Ticks()
        self.truth = dict.fromkeys(self.specs, 0.0)
        self.garbled = {}

    def _feedback(self, spec):
        self.position[spec.can_id] = self.truth[spec.can_id]
        good = super()._feedback(spec)
        garbage = self.garbled.get(spec.can_id)
        return good if garbage is None else good[:1] + garbage + good[-1:]


@for_all(ticks=st.lists(TICK, min_size=1, max_size=40))
def test_a_position_is_one_that_the_motor_has_had_whatever_happens_to_its_answers(ticks):
    """Replies are lost, doubled, late or garbled."""
    with WalkingBus(WALKERS) as bus:
        chain = MotorChain(bus, WALKERS, channel="desk")
        bus.truth = {1: 0.3, 2: -1.0, 3: 4.0}
        chain.refresh()
        had = {spec.can_id: [bus.truth[spec.can_id]] for spec in WALKERS}
        garbled = 0
        for tick in ticks:
            fates = dict(zip(had, tick["fate"], strict=True))
            for spec, step in zip(WALKERS, tick["step"], strict=True):
                bus.truth[spec.can_id] += step
                had[spec.can_id].append(bus.truth[spec.can_id])
            bus.clock.now_s += 0.004
            stamp_before = chain.stamp_s.copy()
            bus.silent = {i for i, fate in fates.items() if fate == "lost"}
            bus.late = {i for i, fate in fates.items() if fate == "late"}
            bus.doubled = {i for i, fate in fates.items() if fate == "twice"}
            bus.garbled = {i: tick["garbage"] for i, fate in fates.items() if fate == "garbled"}
            chain.send(np.zeros((3, 5)))
            if tick["release"]:
                bus.release()
            now = bus.clock.now()
            chain.collect(now)
            assert np.all(chain.stamp_s >= stamp_before) and np.all(chain.stamp_s <= now)
            assert np.all(chain.asked_s <= chain.stamp_s)
            for spec, position in zip(WALKERS, chain.position_rad.tolist(), strict=True):
                nearest = min(abs(position - q) for q in had[spec.can_id])
                garbled += spec.can_id in bus.garbled
                assert nearest <= quantum(spec.type) * 1.001 + (REACH_RAD if garbled else 0.0)
        assert np.isfinite(chain.position_rad).all()


@for_all(
    kind=st.sampled_from(sorted(MOTOR_TYPES)),
    start=finite(0.999),
    steps=st.lists(st.floats(-0.4999, 0.4999), min_size=1, max_size=40),
)
def test_turns_are_followed_however_far(kind, start, steps):
    half = MOTOR_TYPES[kind].position_max_rad
    step_rad = quantum(kind)
    store = FeedbackStore([kind], [True])
    position, now = start * half, 0.0
    for step in [0.0, *steps]:
        position += step * (2 * half - 2 * step_rad)
        now += 10.0  # in which it may have gone anywhere
        wrapped = (position + half) % (2 * half) - half
        store.take(0, encode_feedback(kind, 1, 1, wrapped, 0, 0, 0, 0), now, now, now, now)
        store.publish()
        assert abs(store.position_rad[0] - position) <= 1.001 * step_rad


# the handle's check before the loop


def configuration_replies():
    """What a handle answers to a question about its firmware or its memory."""
    version = st.tuples(*[st.integers(0, 255)] * 3).map(handle_encoder.encode_version)
    return version | st.integers(0, 255).map(handle_encoder.encode_eeprom_byte)


@for_all(
    short=60,
    firmware=st.tuples(*[st.integers(0, 255)] * 3) | st.just(FIRMWARE_REQUIRED),
    eeprom=st.binary(min_size=handle_encoder.EEPROM_BYTES, max_size=handle_encoder.EEPROM_BYTES) | st.just(bytes(31)),
    present=st.sampled_from([True, True, True, False]),
    noise=st.lists(messages() | impostors(REQUEST_ID, configuration_replies()), max_size=4),
)
def test_a_handle_is_prepared_or_refused_by_name(monkeypatch_once, firmware, eeprom, present, noise):
    with NoisyBus([], handle=present) as bus:
        bus.firmware, bus.eeprom = firmware, bytearray(eeprom)
        bus.noise = [m for m in noise if m.arbitration_id != REQUEST_ID or not is_classic_data(m)]
        try:
            found, frequency_hz = prepare_handle(bus, "desk", timeout_s=1.0 if present else 0.0005)
        except MotorError as error:
            assert "desk" in str(error) and "handle" in str(error)
            assert not present or firmware < FIRMWARE_REQUIRED
            return
        assert found == firmware and present
        asked = [m for m in bus.sent if m.data[1] == handle_encoder.OP_SET_REPORT_FREQUENCY]
        assert bool(asked) == (frequency_hz > 0)


@pytest.fixture(scope="module")
def monkeypatch_once():
    """A handle that falls silent at once need not be listened to for 0.1 s, ten thousand times."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(handle_check, "_SILENCE_S", 0.0)
        yield
