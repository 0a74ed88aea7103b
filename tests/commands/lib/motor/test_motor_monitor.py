"""Latency and loss from what is heard."""

import can
import pytest

from lerobot_robot_yam.commands.lib.motor.motor_monitor import Traffic


def frame(identifier, at_s, **kinds):
    return can.Message(arbitration_id=identifier, data=bytes(8), timestamp=at_s, is_extended_id=False, **kinds)


def test_an_answer_belongs_to_the_command_before_it():
    traffic = Traffic()
    for tick in range(10):
        traffic.take(frame(3, tick * 0.004))
        if tick != 5:
            traffic.take(frame(19, tick * 0.004 + 0.001))
    figures = traffic.motors[3].figures()
    assert (figures["commands"], figures["lost"]) == (10, 1)
    assert figures["latency_ms_max"] == pytest.approx(1.0) and figures["period_ms_p50"] == pytest.approx(4.0)


def test_commands_of_every_mode_count_and_other_frames_do_not():
    traffic = Traffic()
    for identifier in (3, 0x103, 0x203, 0x303, 0x7FF, 0x50E):
        traffic.take(frame(identifier, 1.0))
    traffic.take(frame(0x40, 1.0, is_error_frame=True))
    assert traffic.motors[3].commands == 4 and traffic.others == {0x7FF: 1, 0x50E: 1}
    assert (traffic.frames, traffic.error_frames) == (6, 1)
    assert traffic.load(1.0) == pytest.approx(6 * 130e-6)


def test_answers_to_nothing_are_no_latency():
    traffic = Traffic()
    traffic.take(frame(19, 1.0))
    assert traffic.motors[3].figures()["latency_ms_max"] is None


def test_a_motor_that_never_answers_has_no_latency_rather_than_a_perfect_one():
    traffic = Traffic()
    for tick in range(3):
        traffic.take(frame(3, tick * 0.004))
    figures = traffic.motors[3].figures()
    assert (figures["lost"], figures["latency_ms_p99"]) == (2, None) and figures["period_ms_max"] == 4.0
