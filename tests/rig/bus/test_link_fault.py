"""Faults of a channel's interface and cable, as a python-can client and the shipped driver meet them."""

import contextlib
import errno
import threading
import time

import can
import pytest

from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import BusError

CHANNEL = "follower_left"
DOWN, NO_DEVICE, FULL = errno.ENETDOWN, errno.ENODEV, errno.ENOBUFS


def refresh(can_id=1):
    return can.Message(arbitration_id=0x7FF, data=(can_id, 0, 0xCC, 0, 0, 0, 0, 0), is_extended_id=False)


def enable(can_id, command=SpecialCommand.ENABLE):
    return can.Message(arbitration_id=can_id, data=command.value, is_extended_id=False)


def answers(bus):
    """Whether a motor answers: sent for, and waited for, on a bus that works."""
    while bus.recv(0) is not None:
        pass
    bus.send(refresh())
    return bus.recv(5.0) is not None


@contextlib.contextmanager
def raises(code, text):
    with pytest.raises(can.CanOperationError, match=rf"{text} \[Error Code {code}\]") as caught:
        yield
    assert caught.value.error_code == code


@pytest.fixture(autouse=True)
def healthy(rig):
    yield
    rig.clear_faults(CHANNEL)


def motor(rig, name="joint_1"):
    return rig.state()["arms"][CHANNEL]["motors"][name]


def test_an_interface_that_is_down_raises_until_it_is_up(rig, bus):
    rig.fault(CHANNEL, None, "link_down")
    for _ in range(2):
        with raises(DOWN, "Failed to transmit: Network is down"):
            bus.send(enable(1))
        with raises(DOWN, "Error receiving: Network is down"):
            bus.recv(0)
    assert not motor(rig)["enabled"]
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as late:  # SocketCAN lets it open, too
        with raises(DOWN, "Network is down"):
            late.recv(0.1)
        rig.fault(CHANNEL, None, "link_down", False)
        assert answers(bus)
        assert answers(late)
    kinds = [(e["fault"], e["value"]) for e in rig.events() if e["kind"] == "fault_set"]
    assert kinds[-2:] == [("link_down", True), ("link_down", False)]


@pytest.mark.parametrize(("kind", "code"), [("link_down", DOWN), ("adapter_gone", NO_DEVICE)])
def test_a_receive_that_waits_is_woken(rig, kind, code):
    errors = []
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as bus:

        def wait():
            try:
                bus.recv(None)
            except can.CanOperationError as error:
                errors.append(error.error_code)

        thread = threading.Thread(target=wait)
        thread.start()
        time.sleep(0.05)
        rig.fault(CHANNEL, None, kind)
        thread.join(10)
    assert errors == [code]


def test_an_unplugged_adapter_kills_open_buses_for_good_and_can_come_back(rig):
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as old:
        rig.fault(CHANNEL, None, "adapter_gone")
        for attempt in range(2):
            with raises(NO_DEVICE, "Failed to transmit: No such device"):
                old.send(enable(1))
            with raises(NO_DEVICE, "Error receiving: No such device"):
                old.recv(0)
            if attempt == 0:
                with pytest.raises(BusError, match=f"{CHANNEL}.*no such device"):
                    can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name)
                assert rig.state()["arms"][CHANNEL]["clients"] == 0
                rig.fault(CHANNEL, None, "adapter_gone", False)
        with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as new:
            assert answers(new)
        assert not motor(rig)["enabled"]


def test_an_adapter_can_come_back_down(rig):
    """As after a re-enumeration: it is there, and nobody has set it up yet."""
    rig.fault(CHANNEL, None, "link_down")
    rig.fault(CHANNEL, None, "adapter_gone")
    rig.fault(CHANNEL, None, "adapter_gone", False)
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as bus:
        with raises(DOWN, "Network is down"):
            bus.send(refresh())
        rig.fault(CHANNEL, None, "link_down", False)
        assert answers(bus)


def test_bus_off_is_told_once_and_fills_the_queue(rig, bus):
    rig.fault(CHANNEL, None, "bus_off")
    told = bus.recv(5.0)
    assert (told.is_error_frame, told.arbitration_id, told.dlc) == (True, 0x40, 8)
    for _ in range(10):
        bus.send(enable(1))
    for _ in range(2):
        with raises(FULL, "Failed to transmit: No buffer space available"):
            bus.send(enable(1))
    assert bus.recv(0.02) is None
    assert not motor(rig)["enabled"]
    rig.fault(CHANNEL, None, "bus_off", False)
    assert answers(bus)
    assert not motor(rig)["enabled"]  # what was queued has not come out either
    rig.fault(CHANNEL, None, "bus_off")
    bus.send(refresh())  # and the queue is empty again
    assert bus.recv(5.0).is_error_frame


def test_taking_the_link_down_and_up_ends_bus_off(rig, bus):
    rig.fault(CHANNEL, None, "bus_off")
    rig.fault(CHANNEL, None, "link_down")
    rig.fault(CHANNEL, None, "link_down", False)
    assert answers(bus)


def test_foreign_frames_that_command_nothing_are_eight_zeros(rig, bus):
    rig.fault(CHANNEL, None, "foreign", {"id": 0x321, "rate_hz": 200.0, "payload": "zero"})
    heard = bus.recv(2.0)
    assert (heard.arbitration_id, bytes(heard.data)) == (0x321, bytes(8))


def test_clearing_ends_every_fault_of_a_channel(rig):
    rig.fault(CHANNEL, None, "foreign", {"id": 0x321, "rate_hz": 200.0})
    for kind in ("cable_out", "link_down", "adapter_gone", "bus_off"):
        rig.fault(CHANNEL, None, kind)
    rig.clear_faults(CHANNEL)
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as bus:
        while (frame := bus.recv(0.05)) is not None:
            assert frame.arbitration_id == 0x321  # still on its way
        assert answers(bus)
