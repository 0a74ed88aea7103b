"""An adapter that delays frames or keeps them back: when motors and host get them."""

import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao import codec, registers
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S
from lerobot_robot_yam.rig.bus.adapter import HoldBack
from lerobot_robot_yam.rig.control import running_rig
from scripts import recorders
from tests.support.rigged import rig_of

CHANNEL = "follower_left"
WRIST, KIND = 6, "DM4310"
LSB_RAD = 25.0 / 65535


@pytest.fixture
def lockstep():
    """A rig in lock-step, a bus on it, and its clock."""
    with (
        rig_of("lockstep", arms=[CHANNEL], friction=0) as rig,
        can.Bus(interface="yam_lockstep", channel=CHANNEL, rig=rig.name) as bus,
    ):
        yield rig, bus, rig.now, rig.sleep


def message(can_id, data):
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def enable(bus, can_id=WRIST):
    bus.send(message(can_id, SpecialCommand.ENABLE.value))
    assert bus.recv(5.0) is not None


def swing(can_id=WRIST, tau=1.0):
    return message(can_id, codec.encode_mit(KIND, 0, 0, 0, 0.05, tau))


@pytest.mark.parametrize("latency_s", [0.001, 0.005, 0.02, 0.04])
def test_commands_reach_the_motor_late_and_answers_the_host(lockstep, latency_s):
    rig, bus, now, sleep = lockstep
    enable(bus)
    recorders.truth_start(rig, CHANNEL, 5.0)
    rig.fault(CHANNEL, None, "latency_s", latency_s)
    sleep(0.1)
    sent_s = now()
    bus.send(swing())
    answer = bus.recv(5.0)
    got_s = now()
    sleep(0.1)
    truth = recorders.truth(rig, CHANNEL)
    moved_s = truth["stamp_s"][np.abs(truth["torque_nm"][:, WRIST - 1]) > 0.5][0]
    late_s = 0.004
    assert latency_s <= moved_s - sent_s <= latency_s + late_s
    assert 2 * latency_s + FRAME_TIME_S <= got_s - sent_s + 1e-9 <= 2 * latency_s + 2 * FRAME_TIME_S + late_s
    assert answer.timestamp == pytest.approx(sent_s + 2 * latency_s + 2 * FRAME_TIME_S, abs=late_s)
    assert answer.timestamp <= got_s


@pytest.mark.parametrize("latency_s", [0.0, 0.001, 0.005, 0.02, 0.04])
def test_an_answer_tells_the_state_at_the_moment_of_the_answer(lockstep, latency_s):
    """Which is a latency before its stamp, up to its own way over the wire; and in order."""
    rig, bus, now, sleep = lockstep
    enable(bus)
    rig.fault(CHANNEL, None, "latency_s", latency_s)
    recorders.truth_start(rig, CHANNEL, 5.0)
    answers = []
    begin = now()
    while now() < begin + 0.6:
        bus.send(swing(tau=0.4 if now() < begin + 0.3 else -0.4))
        until = now() + 0.004
        while (answer := bus.recv(max(0.0, until - now()))) is not None:
            answers.append(answer)
    sleep(0.1)
    while (answer := bus.recv(0.0)) is not None:
        answers.append(answer)
    truth = recorders.truth(rig, CHANNEL)
    stamps = [answer.timestamp for answer in answers]
    assert stamps == sorted(stamps) and len(stamps) > 100
    seen = np.array([codec.decode_feedback(KIND, answer.data).position for answer in answers])
    true = np.interp(np.array(stamps) - latency_s - FRAME_TIME_S, truth["stamp_s"], truth["q"][:, WRIST - 1])
    assert np.ptp(true) > 0.5
    assert np.abs(seen - true).max() < LSB_RAD + 0.001


def test_a_client_that_falls_silent_has_been_heard(lockstep):
    """Frames that the adapter has taken go out, though nobody waits for the answer."""
    rig, bus, _, sleep = lockstep
    rig.fault(CHANNEL, None, "latency_s", 0.02)
    bus.send(message(WRIST, SpecialCommand.ENABLE.value))
    assert not rig.state()["arms"][CHANNEL]["motors"]["joint_6"]["enabled"]
    sleep(0.019)
    assert not rig.state()["arms"][CHANNEL]["motors"]["joint_6"]["enabled"]
    sleep(0.002)
    assert rig.state()["arms"][CHANNEL]["motors"]["joint_6"]["enabled"]


def test_whole_ticks_stay_in_order_and_complete(lockstep):
    rig, bus, now, sleep = lockstep
    rig.fault(CHANNEL, None, "latency_s", 0.04)
    for tick in range(50):
        bus.send_many([message(0x7FF, registers.encode_refresh(i)) for i in range(1, 8)])
        if tick == 25:  # less of it must not let later frames pass earlier ones
            rig.fault(CHANNEL, None, "latency_s", 0.0)
        sleep(0.004)
    sleep(0.1)
    answers = []
    while (answer := bus.recv(0.0)) is not None:
        answers.append(answer)
    assert [answer.arbitration_id for answer in answers] == [16 + i for i in range(1, 8)] * 50
    stamps = [answer.timestamp for answer in answers]
    assert stamps == sorted(stamps)
    assert rig.device.channels[CHANNEL].overflows == 0


def test_a_link_that_is_down_loses_frames_under_way(lockstep):
    rig, bus, _, sleep = lockstep
    rig.fault(CHANNEL, None, "latency_s", 0.02)
    bus.send(message(WRIST, SpecialCommand.ENABLE.value))
    rig.fault(CHANNEL, None, "cable_out")
    sleep(0.05)
    assert not rig.state()["arms"][CHANNEL]["motors"]["joint_6"]["enabled"]


def test_other_clients_hear_late_frames_too(lockstep):
    rig, bus, now, _ = lockstep
    with can.Bus(interface="yam_lockstep", channel=CHANNEL, rig=rig.name) as other:
        rig.fault(CHANNEL, None, "latency_s", 0.01)
        sent_s = now()
        bus.send(message(WRIST, SpecialCommand.ENABLE.value))
        command, answer = other.recv(1.0), other.recv(1.0)
        assert (command.arbitration_id, answer.arbitration_id) == (WRIST, WRIST + 16)
        assert command.timestamp == pytest.approx(sent_s + 0.02 + FRAME_TIME_S)
        assert answer.timestamp == pytest.approx(sent_s + 0.02 + 2 * FRAME_TIME_S)


def ask_for(bus, now, seconds):
    """Ask the wrist every 4 ms; (asked, received, stamp) of each answer, in the order of the answers."""
    asked, got = [], []
    begin = now()
    while now() < begin + seconds:
        asked.append(now())
        bus.send(message(0x7FF, registers.encode_refresh(WRIST)))
        until = now() + 0.004
        while (answer := bus.recv(max(0.0, until - now()))) is not None:
            got.append((now(), answer.timestamp))
    return [(sent_s, *pair) for sent_s, pair in zip(asked, got, strict=False)]


def test_frames_are_held_back_and_then_come_at_once_in_order(lockstep):
    rig, bus, now, sleep = lockstep
    sleep(0.05)
    begin = now()
    rig.fault(CHANNEL, None, "hold_back", {"seconds": 0.05, "every_s": 0.3})
    rows = np.array(ask_for(bus, now, 1.0))
    late_s = rows[:, 1] - rows[:, 0]
    slack_s = 0.001
    assert 0.045 < late_s.max() < 0.052 + slack_s
    held = late_s > 0.01
    assert 30 < held.sum() < 60  # four bursts of 12
    phase_s = (rows[held, 0] - begin) % 0.3
    assert ((phase_s < 0.05 + slack_s) | (phase_s > 0.3 - slack_s)).all()
    assert (np.diff(rows[:, 2]) >= 0.0).all()
    age_s = rows[:, 1] - rows[:, 2]  # how old an answer is, by its stamp
    assert age_s.max() < slack_s
    rig.clear_faults(CHANNEL)
    sleep(0.06)
    while bus.recv(0.0) is not None:
        pass
    assert np.diff(np.array(ask_for(bus, now, 0.4))[:, :2]).max() < 0.002 + slack_s


def test_times_at_which_a_frame_is_released():
    hold = HoldBack(10.0, 0.05, 0.3)
    assert hold.release_s(9.9) == 9.9
    assert hold.release_s(10.0) == pytest.approx(10.05)
    assert hold.release_s(10.04) == pytest.approx(10.05)
    assert hold.release_s(10.06) == 10.06
    assert hold.release_s(10.31) == pytest.approx(10.35)
    assert HoldBack(10.0, 0.05).release_s(10.31) == 10.31


@pytest.mark.alone
def test_the_rig_wakes_in_time_for_a_late_command():
    with running_rig(arms=[CHANNEL], latency_s=0.002) as rig:
        with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as bus:
            ways_s = []
            for _ in range(100):
                sent_s = time.monotonic()
                bus.send(message(0x7FF, registers.encode_refresh(1)))
                assert bus.recv(5.0) is not None
                ways_s.append(time.monotonic() - sent_s)
        assert 0.004 < np.median(ways_s) < 0.006
