import math
import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.handle_encoder import EVENT_ID, HandleEncoder, encode_report
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Opcode, Register, encode_reply
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S, ReceiveMode
from lerobot_robot_yam.errors import ActionError, BusError, ConfigError, MotorError
from tests.support.desk_bus import SPECS, DeskBus, encode_feedback
from tests.support.rigged import exchange

STEP_RAD = 25.0 / 65535  # one code of the position


def commands(q=0.0):
    table = np.zeros((7, 5))
    table[:, 0] = q
    return table


def tick(chain, q=0.0, wait_s=0.0):
    chain.send(commands(q))
    return chain.collect(time.monotonic() + wait_s)


def test_all_commands_go_out_before_any_reply_is_read(bus, chain):
    chain.send(commands())
    assert [message.arbitration_id for message in bus.sent] == [1, 2, 3, 4, 5, 6, 7]
    assert np.all(chain.stamp_s == -math.inf)
    assert chain.collect(time.monotonic())
    assert np.all(chain.stamp_s > 0)


def test_state_is_what_the_motors_report(bus, chain):
    q = np.linspace(-1.5, 1.5, 7)
    bus.fault[3] = 0xD
    before = time.monotonic()
    assert tick(chain, q)
    np.testing.assert_allclose(chain.position_rad, q, atol=2 * STEP_RAD)
    np.testing.assert_allclose(chain.torque_nm, 0.0, atol=0.02)
    assert chain.temp_mos_c.tolist() == [30.0] * 7
    assert chain.temp_rotor_c.tolist() == [31.0] * 7
    assert chain.fault.tolist() == [1, 1, 0xD, 1, 1, 1, 1]
    now = time.monotonic()
    assert np.all((chain.stamp_s >= before) & (chain.stamp_s <= now))
    assert np.all(chain.asked_s >= before)


def test_arrays_handed_out_do_not_change_later(chain):
    tick(chain, 0.5)
    kept = chain.position_rad
    tick(chain, 0.503)
    np.testing.assert_allclose(kept, 0.5, atol=2 * STEP_RAD)
    np.testing.assert_allclose(chain.position_rad, 0.503, atol=2 * STEP_RAD)


def test_a_silent_motor_ages_alone(bus, chain):
    tick(chain)
    stamp = chain.stamp_s
    bus.silent.add(4)
    for _ in range(3):
        assert not tick(chain)
    assert chain.missed.tolist() == [0, 0, 0, 3, 0, 0, 0]
    assert chain.lost.tolist() == [0, 0, 0, 2, 0, 0, 0]  # the answer to the last question may still come
    assert chain.stamp_s[3] == stamp[3]
    assert np.all(np.delete(chain.stamp_s - stamp, 3) > 0)
    assert chain.position_rad[3] == pytest.approx(0.0, abs=STEP_RAD)


def test_a_late_reply_is_used_but_does_not_put_the_chain_behind(bus, chain):
    tick(chain)
    bus.late.add(2)
    assert not tick(chain, 0.002)
    bus.late.clear()
    bus.release()
    assert tick(chain, 0.003)
    np.testing.assert_allclose(chain.position_rad, 0.003, atol=2 * STEP_RAD)
    assert not chain.lost.any() and not chain.missed.any() and not chain.duplicates.any()


def test_a_caller_that_sleeps_past_the_deadline_takes_all_answers_that_have_come(bus, chain):
    bus.late.update(bus.specs)
    bus.late_by_a_wait = True
    assert tick(chain, 0.1, wait_s=0.01)
    assert not chain.lost.any()


def test_a_reply_that_overtakes_nothing_still_counts_for_its_motor_only(bus, chain):
    bus.late.update((1, 2, 3))
    chain.send(commands(0.3))
    bus.release()
    assert chain.collect(time.monotonic())
    np.testing.assert_allclose(chain.position_rad, 0.3, atol=2 * STEP_RAD)


def test_two_motors_with_one_id_are_noticed(bus, chain):
    bus.doubled.add(5)
    for _ in range(5):
        tick(chain)
    assert chain.duplicates[4] >= 2
    assert not np.delete(chain.duplicates, 4).any()


def test_a_motor_that_turns_is_followed_over_the_end_of_the_wire_and_a_joint_is_not(bus, chain):
    """On the wire both go from just below 12.5 to just above -12.5 rad."""
    for q in (12.498, 12.501):
        bus.position = dict.fromkeys(bus.specs, q)
        chain.refresh()
    np.testing.assert_allclose(chain.position_rad, [12.498] * 6 + [12.501], atol=2 * STEP_RAD)
    assert chain.feedback._judge.rejected == [1] * 6 + [0]


def test_storing_zero_takes_the_next_reading_as_it_is(bus, chain):
    bus.position = dict.fromkeys(bus.specs, 8.0)
    chain.refresh()
    bus.position = dict.fromkeys(bus.specs, 0.0)
    assert all(chain.refresh())
    assert chain.position_rad[0] == pytest.approx(8.0, abs=2 * STEP_RAD)
    assert all(chain.special(SpecialCommand.ZERO))
    np.testing.assert_allclose(chain.position_rad, 0.0, atol=2 * STEP_RAD)


def test_special_commands_reach_every_motor_and_report_the_motors_that_answered(bus, chain):
    bus.silent.add(7)
    assert chain.special(SpecialCommand.ENABLE, timeout_s=0.01) == [True] * 6 + [False]
    assert [m.data for m in bus.sent] == [SpecialCommand.ENABLE.value] * 7
    assert not chain.lost.any()  # counts replies of the loop only


def test_a_motor_that_is_left_out_to_find_losses_is_switched_off_with_the_others(bus, chain):
    bus.silent.update(range(1, 8))
    for _ in range(60):  # all owe more than they used to
        bus.sent.clear()
        tick(chain)
    assert [message.arbitration_id for message in bus.sent] == [2, 3, 4, 5, 6, 7]
    bus.sent.clear()
    chain.send(commands(), dict.fromkeys(range(7), SpecialCommand.DISABLE))
    assert [message.data for message in bus.sent] == [SpecialCommand.DISABLE.value] * 7


def test_wrong_commands_send_nothing(bus, chain):
    with pytest.raises(ActionError, match=r"\(7, 5\)"):
        chain.send(np.zeros((6, 5)))
    bad = commands()
    bad[6, 4] = math.nan
    with pytest.raises(ActionError, match="torque"):
        chain.send(bad)
    assert not bus.sent


def test_frames_of_others_are_counted_and_not_taken(bus, chain):
    bus.put(3, bytes(8))  # another driver commands motor 3
    bus.put(0x123, b"\x01")
    bus.put(0x14, encode_feedback("DM4310", 2, 1, 5.0, 0, 0, 0, 0))  # motor 2 answering as motor 4 would
    bus.put(0x11, b"")
    bus.put(0x11, bytes(8), is_error_frame=True)
    tick(chain, 0.5)
    np.testing.assert_allclose(chain.position_rad, 0.5, atol=2 * STEP_RAD)
    assert chain.foreign_commands == 1
    assert chain.foreign == {3: 1, 0x123: 1, 0x14: 1, 0x11: 1}
    assert chain.error_frames == 1


@pytest.mark.parametrize("mode", ReceiveMode)
def test_receive_modes(mode):
    specs = [MotorSpec("a", 2, "DM4310", mode), MotorSpec("b", 5, "DM4340", mode)]
    with DeskBus(specs) as bus:
        chain = MotorChain(bus, specs, channel="desk")
        table = np.zeros((2, 5))
        table[:, 0] = [0.5, -0.5]
        chain.send(table)
        assert chain.collect(time.monotonic())
        np.testing.assert_allclose(chain.position_rad, [0.5, -0.5], atol=2 * STEP_RAD)


def test_registers_are_read(chain):
    assert chain.read_register(3, Register.TMAX) == 10.0
    assert chain.read_register(2, Register.TIMEOUT) == 8000


def test_a_register_is_asked_for_again_and_the_late_answer_is_not_taken_for_feedback(bus, chain):
    tick(chain, 1.0)
    bus.late.add(1)
    with pytest.raises(MotorError, match=r"joint1 \(id 1\).*PMAX"):
        chain.read_register(0, Register.PMAX, timeout_s=0.005, attempts=2)
    bus.late.clear()
    bus.release()
    assert tick(chain, 1.0)
    np.testing.assert_allclose(chain.position_rad, 1.0, atol=2 * STEP_RAD)


def test_a_register_answer_of_another_motor_or_register_does_not_count(bus, chain):
    bus.silent.add(1)
    bus.put(0x11, encode_reply(1, Opcode.READ, Register.VMAX, 1.0))
    with pytest.raises(MotorError):
        chain.read_register(0, Register.PMAX, timeout_s=0.005, attempts=1)


def test_the_handle_is_asked_after_the_motors(bus):
    handle = HandleEncoder()
    chain = MotorChain(bus, SPECS, channel="desk", encoder=handle)
    bus.handle_data = encode_report(0.35, 0.0, (True, False))
    assert tick(chain)
    assert [m.arbitration_id for m in bus.sent] == [1, 2, 3, 4, 5, 6, 7, 0x50E]
    assert handle.report.trigger == pytest.approx(0.5, abs=2e-3)
    assert handle.report.buttons == (True, False)
    assert handle.lost == 0
    assert chain.expected_wire_s == pytest.approx(16 * FRAME_TIME_S)


def test_requests_to_the_motors_alone_do_not_make_the_handle_look_silent(bus):
    handle = HandleEncoder()
    chain = MotorChain(bus, SPECS, channel="desk", encoder=handle)
    chain.refresh()
    assert handle.lost == 0
    tick(chain)
    assert handle.stamp_s > 0


@pytest.mark.parametrize("opcode", [Opcode.READ, Opcode.WRITE])
@pytest.mark.parametrize("between", [True, False])
def test_the_answer_to_somebody_elses_register_question_is_no_feedback(bus, chain, opcode, between):
    tick(chain)
    before = chain.position_rad.copy()
    answer = encode_reply(1, opcode, Register.PMAX, 12.5)
    if between:
        bus.put(0x11, answer)
        chain.drain()
    else:
        chain.send(commands())
        bus._queue.appendleft(can.Message(arbitration_id=0x11, data=answer, is_extended_id=False))
        chain.collect(time.monotonic() + 0.01)
    chain.feedback.publish()
    np.testing.assert_array_equal(chain.position_rad, before)
    assert chain.fault[0] == 1 and chain.foreign == {0x11: 1}
    tick(chain)
    np.testing.assert_array_equal(chain.position_rad, before)


def test_a_silent_handle_is_counted_and_holds_up_one_tick_only(bus):
    handle = HandleEncoder()
    chain = MotorChain(bus, SPECS, channel="desk", encoder=handle)
    bus.handle = False
    assert tick(chain)
    chain.send(commands())
    assert chain.collect(time.monotonic() + 3600)  # would wait for an hour
    assert handle.lost == 2
    bus.handle = True
    tick(chain)  # its answer is not waited for and found at the next tick
    tick(chain)
    stamp, lost = handle.stamp_s, handle.lost
    assert stamp > 0
    tick(chain)
    assert handle.stamp_s > stamp
    assert handle.lost == lost == 3


def test_a_button_edge_counts_at_once(bus):
    handle = HandleEncoder()
    chain = MotorChain(bus, SPECS, channel="desk", encoder=handle)
    bus.handle = False
    bus.put(EVENT_ID, encode_report(0.0, 0.0, (False, True)))
    tick(chain)
    assert handle.report.buttons == (False, True)
    assert handle.lost == 1


def test_a_bus_that_fails_is_a_bus_error(bus, chain):
    def fail(*_, **__):
        raise can.CanOperationError("No buffer space available [Errno 105]")

    broken = DeskBus(SPECS)
    broken.send = fail
    with broken, pytest.raises(BusError, match="desk: send failed.*No buffer space"):
        tick(MotorChain(broken, SPECS, channel="desk"))
    deaf = DeskBus(SPECS)
    deaf._recv_internal = fail
    with deaf, pytest.raises(BusError, match="receive failed"):
        tick(MotorChain(deaf, SPECS, channel="desk"))


@pytest.mark.parametrize(
    ("specs", "message"),
    [
        ([MotorSpec("a", 1, "DM4310"), MotorSpec("a", 2, "DM4310")], "unique"),
        ([MotorSpec("a", 1, "DM4310"), MotorSpec("b", 1, "DM4310")], "unique"),
        ([MotorSpec("a", 0, "DM4310")], "id 0"),
        ([MotorSpec("a", 1, "DM1")], "DM1"),
    ],
)
def test_impossible_chains_are_refused(bus, specs, message):
    with pytest.raises(ConfigError, match=message):
        MotorChain(bus, specs, channel="desk")


def test_exchange_over_a_python_can_interface_without_our_extras():
    name = f"chain-{time.monotonic_ns()}"
    with (
        can.Bus(interface="virtual", channel=name) as ours,
        can.Bus(interface="virtual", channel=name) as theirs,
    ):
        chain = MotorChain(ours, SPECS[:1], channel=name)
        theirs.send(
            can.Message(
                arbitration_id=0x11,
                data=encode_feedback("DM4340", 1, 1, 9.0, 0, 0, 0, 0),
                is_extended_id=False,
            )
        )
        assert not exchange(chain, np.zeros((1, 5)), timeout_s=0.0)  # what came before the request is no answer
        assert chain.missed.tolist() == [1] and chain.duplicates.tolist() == [1]
        sent = theirs.recv(1.0)
        assert sent is not None
        assert (sent.arbitration_id, bytes(sent.data).hex()) == (1, "7fff7ff000000800")
