"""The python-can interface `yam_sim` on a live rig: each client hears the others, and delays none."""

import contextlib
import os
import resource
import threading
import time

import can
import pytest

from lerobot_robot_yam.damiao import codec, handle_encoder
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import BusError, ConfigError
from lerobot_robot_yam.rig.control import RigControl, running_rig

CHANNEL = "follower_left"


def message(can_id, data):
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


REFRESH = [message(0x7FF, bytes((i, 0, 0xCC, 0, 0, 0, 0, 0))) for i in range(1, 8)]


def test_a_request_is_answered_after_its_time_on_the_wire(bus):
    before = time.monotonic()
    bus.send(REFRESH[0])
    answer = bus.recv(5.0)
    assert time.monotonic() - before >= 2 * 130e-6
    assert (answer.arbitration_id, answer.dlc, answer.channel) == (0x11, 8, CHANNEL)
    assert before + 2 * 130e-6 <= answer.timestamp <= time.monotonic()
    assert codec.decode_feedback("DM4340", bytes(answer.data)).motor_id == 1


def test_a_process_with_many_open_files_is_answered_too(rig):
    """select takes descriptors below 1024 only."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.ExitStack() as stack:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(limits[0], 2048), limits[1]))
        stack.callback(resource.setrlimit, resource.RLIMIT_NOFILE, limits)
        while (spare := os.dup(0)) < 1024:
            stack.callback(os.close, spare)
        stack.callback(os.close, spare)
        with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as bus:
            bus.send(REFRESH[0], timeout=1.0)
            assert bus.recv(5.0).arbitration_id == 0x11


def test_a_tick_sent_at_once_is_answered_in_order(bus):
    bus.send_many(REFRESH)
    answers = [bus.recv(5.0) for _ in REFRESH]
    assert [a.arbitration_id for a in answers] == [0x10 + i for i in range(1, 8)]
    stamps = [a.timestamp for a in answers]
    assert all(later - sooner >= 129e-6 for sooner, later in zip(stamps, stamps[1:], strict=False))
    assert bus.recv(0) is None


def test_clients_hear_each_other_but_not_themselves(rig, bus):
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as other:
        bus.send(REFRESH[2])
        assert bus.recv(5.0).arbitration_id == 0x13
        heard = [other.recv(5.0), other.recv(5.0)]
        assert [m.arbitration_id for m in heard] == [0x7FF, 0x13]
        assert bytes(heard[0].data) == bytes(REFRESH[2].data)
        assert bus.recv(0.01) is None


def test_channels_are_separate(rig, bus):
    with can.Bus(interface="yam_sim", channel="follower_right", rig=rig.name) as other:
        bus.send(REFRESH[0])
        assert bus.recv(5.0) is not None
        assert other.recv(0.02) is None


def test_filters_apply(rig):
    filters = [{"can_id": 0x15, "can_mask": 0x7FF}]
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name, can_filters=filters) as bus:
        bus.send_many(REFRESH)
        assert bus.recv(5.0).arbitration_id == 0x15
        assert bus.recv(0.01) is None


def test_extended_and_remote_frames_reach_no_motor(bus):
    bus.send(can.Message(arbitration_id=1, data=SpecialCommand.ENABLE.value, is_extended_id=True))
    bus.send(can.Message(arbitration_id=1, is_extended_id=False, is_remote_frame=True, dlc=8))
    assert bus.recv(0.02) is None


def test_a_leader_has_a_handle_and_no_gripper_motor(rig):
    with can.Bus(interface="yam_sim", channel="leader_right", rig=rig.name) as bus:
        bus.send_many(REFRESH)
        assert [bus.recv(5.0).arbitration_id for _ in range(6)] == [0x11, 0x12, 0x13, 0x14, 0x15, 0x16]
        assert bus.recv(0.01) is None
        bus.send(message(handle_encoder.REQUEST_ID, handle_encoder.encode_report_request()))
        answer = bus.recv(5.0)
        assert answer.arbitration_id == handle_encoder.REPORT_ID
        assert handle_encoder.decode_report(bytes(answer.data)).trigger == 0.0


def test_a_notifier_delivers(bus):
    reader = can.BufferedReader()
    notifier = can.Notifier(bus, [reader], timeout=0.05)
    bus.send(REFRESH[3])
    assert reader.get_message(5.0).arbitration_id == 0x14
    notifier.stop()


def test_shutdown_is_idempotent_and_ends_the_bus(rig):
    bus = can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name)
    bus.shutdown()
    bus.shutdown()
    with pytest.raises(BusError, match="shut down"):
        bus.send(REFRESH[0])
    with pytest.raises(BusError, match="shut down"):
        bus.recv(0)


def test_shutdown_wakes_a_thread_that_waits(rig):
    bus = can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name)
    errors = []

    def wait():
        try:
            bus.recv(None)
        except BusError as error:
            errors.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.05)
    bus.shutdown()
    thread.join(5)
    assert not thread.is_alive()
    assert len(errors) == 1


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"channel": "can0"}, BusError, "no channel 'can0'; it has follower_left, follower_right, leader_left"),
        ({"channel": "leader_lefft"}, BusError, "no channel 'leader_lefft'; did you mean 'leader_left'. It has "),
        ({"fd": True}, BusError, "classic CAN"),
        ({"bitrate": 500_000}, BusError, "1 Mbit/s"),
        ({"receive_own_messages": True}, ConfigError, "echo"),
    ],
)
def test_unsupported_options_are_refused(rig, arguments, error, text):
    with pytest.raises(error, match=text):
        can.Bus(**{"interface": "yam_sim", "channel": CHANNEL, "rig": rig.name} | arguments)


def test_an_fd_frame_is_refused(bus):
    with pytest.raises(BusError, match="CAN FD"):
        bus.send(can.Message(arbitration_id=1, data=bytes(8), is_fd=True, is_extended_id=False))


def test_keywords_of_other_interfaces_are_accepted(rig):
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name, bitrate=1_000_000, data_bitrate=5_000_000):
        pass


@pytest.mark.parametrize(
    ("options", "text"),
    [({"frictoin": 0}, "frictoin"), ({"serials": "off"}, "serials"), ({"scene": "moon"}, "unknown scene 'moon'")],
)
def test_a_rig_that_cannot_start_says_why(options, text):
    with pytest.raises(ConfigError, match=text):
        can.Bus(interface="yam_sim", channel=CHANNEL, rig="test-refused", **options)


@pytest.mark.parametrize("unplugged_before", [False, True])
def test_an_ended_rig_is_a_bus_error(unplugged_before):
    with running_rig() as rig:
        if unplugged_before:
            rig.fault(CHANNEL, None, "adapter_gone")
            rig.fault(CHANNEL, None, "adapter_gone", False)
        bus = can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name)
        rig.end()
        deadline = time.monotonic() + 10
        with pytest.raises(BusError, match="rig has ended"):
            while time.monotonic() < deadline:
                bus.recv(0.1)
        with pytest.raises(BusError, match="rig has ended"):
            bus.send(REFRESH[0])
        bus.shutdown()


def test_another_process_auto_rig_can_be_named(monkeypatch):
    """The control process works on the rig of the LeRobot process."""
    import os

    with can.Bus(interface="yam_sim", channel=CHANNEL) as mine:
        assert mine.rig == f"auto-{os.getpid()}"
        with RigControl(f"auto:{os.getpid()}") as control:
            assert control.name == mine.rig
            assert control.state()["arms"][CHANNEL]["clients"] == 1
        monkeypatch.setenv("YAM_RIG", f"auto:{os.getpid()}")
        with can.Bus(interface="yam_sim", channel=CHANNEL) as again:
            assert again.rig == mine.rig


def tick(bus):
    bus.send_many(REFRESH)
    return [bus.recv(5.0).arbitration_id for _ in REFRESH]


def test_a_new_client_hears_nothing_from_before_it_came(rig, bus):
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as early:
        tick(bus)
        bus.send_many(REFRESH)  # still on the wire when the next one opens
        with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as late:
            heard = []
            while (message := late.recv(0.05)) is not None:
                heard.append(message)
            # The rig may take the last packet in before or after it lets the new client in, but only as a whole.
            assert len(heard) in (0, 14)
            assert tick(bus)  # what came before it is gone for good
            echoes = [late.recv(5.0).arbitration_id for _ in range(14)]
            assert echoes == [0x7FF] * 7 + [0x10 + i for i in range(1, 8)]
            assert late.recv(0.02) is None
        assert early.recv(5.0).arbitration_id == 0x7FF


def test_an_idle_client_loses_frames_and_delays_no_other(rig, bus):
    before = rig.stats()["overflows"][CHANNEL]
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as idle:
        ticks = 0
        while rig.stats()["overflows"][CHANNEL] < before + 50:
            for _ in range(50):
                assert tick(bus) == [0x10 + i for i in range(1, 8)]
            ticks += 50
            assert ticks < 5000, "a socket that never fills"
        kept = 0
        while idle.recv(0) is not None:
            kept += 1
        assert kept % 14 == 0 and 0 < kept < 14 * ticks  # whole packets, the oldest ones
        tick(bus)
        assert [idle.recv(5.0).arbitration_id for _ in range(7)] == [0x7FF] * 7  # and it hears again
        rig.fault(CHANNEL, None, "link_down")
        with pytest.raises(can.CanOperationError, match="Network is down"):
            idle.recv(0)
        rig.clear_faults(CHANNEL)


def test_an_idle_client_with_a_full_socket_still_meets_its_links_state(rig, bus):
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as idle:
        before = rig.stats()["overflows"][CHANNEL]
        while rig.stats()["overflows"][CHANNEL] == before:
            for _ in range(50):
                tick(bus)
        rig.fault(CHANNEL, None, "adapter_gone")
        rig.fault(CHANNEL, None, "adapter_gone", False)
        with pytest.raises(can.CanOperationError, match="No such device"):
            idle.send(REFRESH[0])
