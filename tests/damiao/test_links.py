"""What links and adapters are like: stamps that are right or wrong, queues that are short."""

import time

import can
import pytest

from lerobot_robot_yam.damiao.bus_port import BusPort
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S
from tests.damiao.test_chain import commands, tick
from tests.support.desk_bus import SPECS, DeskBus


def test_kernel_stamps_are_used_where_believable(bus):
    port = BusPort(bus, "desk")
    for offset, believable in ((-0.5, True), (-5.0, False), (+5.0, False)):
        before = time.monotonic()
        message = can.Message(timestamp=time.time() + offset, arbitration_id=0x11, data=bytes(8), is_extended_id=False)
        assert (port.arrival_s(message) < before) == believable


@pytest.mark.parametrize("behind_s", [0.3, 0.9])
def test_an_answer_that_seems_to_come_before_its_question_came_now(bus, chain, behind_s):
    """The clock of an adapter drifts away from ours: its stamps lie further and further in the past."""
    tick(chain)
    for _ in range(3):
        before = time.monotonic()
        chain.send(commands())
        for message in bus._queue:
            message.timestamp = time.time() - behind_s
        assert chain.collect(time.monotonic())
        assert (chain.asked_s >= before).all() and (chain.stamp_s >= before - FRAME_TIME_S).all()


def test_clearing_faults_does_not_overflow_a_link_with_the_default_queue():
    waiting, looked_s = 0.0, time.monotonic()

    class Link(DeskBus):
        """10 frames wait in the interface's queue and 10 in the adapter, and leave as fast as the wire lets them."""

        def send(self, msg, timeout=None):
            nonlocal waiting, looked_s
            now = time.monotonic()
            waiting, looked_s = max(0.0, waiting - (now - looked_s) / FRAME_TIME_S) + 1.0, now
            if waiting > 20.0:
                raise can.CanOperationError("Transmit buffer full")
            super().send(msg)

    with Link(SPECS) as bus:
        assert all(MotorChain(bus, SPECS, channel="desk").special(SpecialCommand.CLEAR, 0.0))
        assert len(bus.sent) == 21
