"""One holder at a time may drive arms, and is heard."""

import pytest

from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.session.lease import Lease


class Clock:
    now_s = 10.0

    def now(self):
        return self.now_s


def test_one_at_a_time_and_whoever_has_it_is_named():
    lease = Lease("the robot")
    lease.take(5, "ann")
    lease.take(5, "ann")  # again
    for refused in (lease.check, lambda holder: lease.take(holder, "bob")):
        with pytest.raises(ChannelInUseError, match="the robot is driven by ann; end that first"):
            refused(6)
    assert lease.holder == 5
    lease.release()
    lease.release()
    lease.take(6, "bob")
    assert (lease.holder, lease.who) == (6, "bob")


def test_silence_is_measured_from_the_last_sign_of_life_of_the_holder():
    clock = Clock()
    lease = Lease("the robot", clock)
    assert lease.silent_s == 0.0 and not lease.renew(None)
    lease.take(5, "ann")
    clock.now_s += 3.0
    assert not lease.renew(6) and lease.silent_s == 3.0
    assert lease.renew(5) and lease.silent_s == 0.0
    clock.now_s += 1.0
    lease.release()
    assert lease.silent_s == 0.0
