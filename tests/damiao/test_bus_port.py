"""Any python-can bus as the chain uses it: waits that no step of the clock lengthens, refusals that are told apart."""

import errno
import time

import can
import pytest

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message
from lerobot_robot_yam.errors import BusError

WAIT_S = 0.05


@pytest.fixture(params=["virtual", "yam_sim"])
def bus(request):
    options = {}
    if request.param == "yam_sim":
        options["rig"] = request.getfixturevalue("rig").name
    with can.Bus(interface=request.param, channel="follower_left", **options) as bus:
        yield bus


def test_a_clock_that_is_set_back_lengthens_no_wait(bus, monkeypatch):
    port = BusPort(bus, "follower_left")
    steps = iter([0.0])
    monkeypatch.setattr("can.bus.time", lambda: time.time() - next(steps, 5.0))  # after the wait has begun
    begin = time.monotonic()
    assert port.recv(WAIT_S) is None
    assert WAIT_S <= time.monotonic() - begin < 1.0


def test_filters_count_and_a_filtered_frame_ends_no_wait():
    with can.Bus(interface="virtual", channel="desk") as sender:
        with can.Bus(interface="virtual", channel="desk", can_filters=[{"can_id": 2, "can_mask": 0x7FF}]) as bus:
            port = BusPort(bus, "desk")
            for wait_s in (WAIT_S, 0.0):
                sender.send(data_message(1, b"x"))
                sender.send(data_message(2, b"y"))
                message = port.recv(wait_s)
                assert message is not None and message.arbitration_id == 2
                assert port.recv(0.0) is None


@pytest.mark.parametrize(
    ("error", "number", "advice"),
    [  # as python-can's socketcan raises them
        (can.CanOperationError("Transmit buffer full"), errno.ENOBUFS, "frames wait.*yam-setup-can.*--reset desk"),
        (can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS), errno.ENOBUFS, "wait"),
        (can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN), errno.ENETDOWN, "link is up"),
        (OSError(errno.ENODEV, "No such device"), errno.ENODEV, "plugged in"),
    ],
)
def test_what_a_channel_refuses_frames_for_is_told_apart(error, number, advice, monkeypatch):
    def refuse(message, timeout=None):
        raise error

    with can.Bus(interface="virtual", channel="desk") as bus:
        monkeypatch.setattr(bus, "send", refuse)
        with pytest.raises(BusError, match=f"desk: send failed.*{advice}") as raised:
            BusPort(bus, "desk").send([data_message(1, b"x")])
    assert raised.value.errno == number
