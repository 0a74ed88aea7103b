"""Faults of a channel's interface and cable, as a python-can client and the shipped driver meet them."""

import contextlib
import errno
import threading
import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.errors import BusError
from tests.support.rigged import exchange

CHANNEL = "follower_left"
TYPES = ["DM4340"] * 3 + ["DM4310"] * 4
DOWN, NO_DEVICE, FULL = errno.ENETDOWN, errno.ENODEV, errno.ENOBUFS


def refresh(can_id=1):
    return can.Message(arbitration_id=0x7FF, data=(can_id, 0, 0xCC, 0, 0, 0, 0, 0), is_extended_id=False)


def enable(can_id, command=SpecialCommand.ENABLE):
    return can.Message(arbitration_id=can_id, data=command.value, is_extended_id=False)


def chain_on(bus):
    motors = [MotorSpec(f"joint_{i}", i, kind) for i, kind in enumerate(TYPES, 1)]
    return MotorChain(bus, motors, channel=CHANNEL)


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


@pytest.fixture
def bus(rig):
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as bus:
        yield bus


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


def test_motors_lose_their_driver_while_the_link_is_down(rig, bus):
    chain = chain_on(bus)
    rig.fault(CHANNEL, "joint_6", "register", 2000, register=9)  # a watchdog of 100 ms
    since = len(rig.events())
    bus.send(enable(6))
    assert bus.recv(5.0) is not None  # it has heard it
    rig.fault(CHANNEL, None, "link_down")
    assert rig.wait_event("motor_fault", 5.0, since, motor="joint_6")["fault"] == 0xD
    rig.fault(CHANNEL, None, "link_down", False)
    chain.refresh(1.0)
    assert chain.fault[5] == 0xD
    rig.fault(CHANNEL, "joint_6", "register", 8000, register=9)


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


def test_the_driver_meets_bus_off_as_silence_and_then_an_error(rig, bus):
    chain = chain_on(bus)
    rig.fault(CHANNEL, None, "bus_off")
    exchange(chain, np.zeros((7, 5)))
    assert (chain.missed == 1).all()
    assert chain.error_frames == 1
    with pytest.raises(BusError, match="No buffer space"):
        exchange(chain, np.zeros((7, 5)))


def test_a_cable_that_is_out_is_only_silence(rig, bus):
    chain = chain_on(bus)
    assert all(chain.refresh(1.0))
    rig.fault(CHANNEL, None, "cable_out")
    for _ in range(20):
        exchange(chain, np.zeros((7, 5)))
    assert (chain.missed == 20).all()
    assert chain.error_frames == 0
    rig.fault(CHANNEL, None, "cable_out", False)
    assert all(chain.refresh(1.0))


def test_a_foreign_driver_is_obeyed_by_motors_and_counted_by_the_chain(rig, bus):
    chain = chain_on(bus)
    q = rig.state()["arms"][CHANNEL]["q"][5]
    bus.send(enable(6, SpecialCommand.CLEAR))
    bus.send(enable(6))
    rig.fault(CHANNEL, None, "foreign", {"id": 6, "rate_hz": 100.0})
    time.sleep(1.0)  # longer than the watchdog waits: somebody feeds it
    chain.drain()
    assert motor(rig, "joint_6")["enabled"]
    assert rig.state()["arms"][CHANNEL]["q"][5] == pytest.approx(q, abs=0.02)
    assert chain.foreign_commands >= 10
    assert chain.duplicates[5] >= 10  # answers that we did not ask for


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
