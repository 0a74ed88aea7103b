"""Packets and wire time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame, Wire

FRAMES = st.builds(
    Frame,
    st.floats(0, 1e9),
    st.integers(0, 0x1FFF_FFFF),
    st.binary(max_size=8),
    st.integers(0, 3),
)


@given(st.lists(FRAMES, max_size=20))
def test_packets_carry_frames_unchanged(frames):
    assert packets.unpack(packets.pack(frames)) == frames


def test_a_broken_packet_is_refused():
    with pytest.raises(BusError, match="23 bytes"):
        packets.unpack(bytes(23))


def test_frames_follow_one_another_at_130_bits_each():
    bus = Wire()
    through = [bus.transmit(10.0) for _ in range(14)]
    assert through[0] == pytest.approx(10.0 + 130e-6)
    assert through[-1] == pytest.approx(10.0 + 14 * 130e-6)  # a tick of seven motors: 549 Hz at most


def test_an_idle_wire_waits_for_the_frame():
    bus = Wire()
    bus.transmit(10.0)
    assert bus.transmit(11.0) == pytest.approx(11.0 + 130e-6)


@pytest.mark.parametrize(("stamp", "expected"), [(9.99, 9.99), (10.5, 10.0), (3.0, 9.95)])
def test_an_implausible_send_stamp_is_corrected(stamp, expected):
    assert packets.send_time(stamp, now_s=10.0) == pytest.approx(expected)
