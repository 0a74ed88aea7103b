"""The encoders of a leader without motors: their reports, and how they are made to send them."""

import contextlib

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao.bus_port import BusPort
from lerobot_robot_yam.damiao.handle_encoder import REPORT_ID, REQUEST_ID, encode_report
from lerobot_robot_yam.damiao.passive_encoders import PassiveEncoders
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig

LEADER = "leader_left"
DESK = [-1, -1, 1, 1, -1, -1]
POSE = [0.2, 1.0, 0.9, -0.3, 0.1, 0.2]


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("passive_leaders", arms=[LEADER])) as rig:
        yield rig


@pytest.fixture
def port(rig):
    with can.Bus(interface="yam_lockstep", channel=LEADER, rig=rig.name) as bus:
        yield BusPort(bus, LEADER)


def frame(ident, data):
    return can.Message(arbitration_id=ident, data=data, is_extended_id=False)


def test_a_report_belongs_to_its_device():
    encoders = PassiveEncoders(6)
    assert encoders.accept(frame(REPORT_ID, encode_report(0.5, -0.25, (False, True), device=2)), 7.0)
    assert encoders.angle_rad[2] == pytest.approx(0.5, abs=1e-3) and encoders.stamp_s[2] == 7.0
    assert encoders.rate_rad_s[2] == pytest.approx(-0.25, abs=1e-3)
    assert encoders.buttons == (False, False)  # those of a joint's device have no meaning
    assert encoders.accept(frame(REPORT_ID, encode_report(0.1, 0.0, (False, True), device=6)), 7.1)
    assert encoders.buttons == (False, True)


@pytest.mark.parametrize(
    "message",
    [
        frame(REQUEST_ID, encode_report(0.5, 0.0, (False, False), device=2)),
        frame(REPORT_ID, encode_report(0.5, 0.0, (False, False), device=7)),
        frame(REPORT_ID, bytes(5)),
        can.Message(arbitration_id=REPORT_ID, data=bytes(6), is_extended_id=True),
    ],
)
def test_other_frames_are_none_of_theirs(message):
    encoders = PassiveEncoders(6)
    assert not encoders.accept(message, 1.0)
    assert not np.isfinite(encoders.stamp_s).any()


def test_silent_devices_are_told_to_report_and_tell_the_pose(rig, port):
    encoders = PassiveEncoders(6)
    rig.trace_start(LEADER)
    encoders.start(port, "leader")
    assert [row[2:] for row in rig.trace(LEADER)] == [(REQUEST_ID, device) for device in range(7)]
    rig.hand(LEADER, [0.5], [POSE], trigger=0.5)
    encoders.collect(port, port.clock.now() + 1.0)
    q = np.array(rig.state()["arms"][LEADER]["q"])
    np.testing.assert_allclose(encoders.angle_rad[:6] * DESK, q, atol=2e-3)
    assert encoders.angle_rad[6] == pytest.approx(0.335, abs=2e-3)
    assert port.clock.now() - encoders.stamp_s.min() < 0.01  # 200 Hz


def test_a_stream_is_not_written_to_again(rig, port):
    PassiveEncoders(6).start(port, "leader")
    rig.trace_start(LEADER)
    PassiveEncoders(6).start(port, "leader")
    assert rig.trace(LEADER) == []


def test_those_that_stay_silent_are_named(rig, port):
    rig.fault(LEADER, None, "encoders_silent", [2, 6])
    begin = port.clock.now()
    with pytest.raises(MotorError, match=r"leader \(leader_left\): no report from joint_3, the trigger within 3 s"):
        PassiveEncoders(6).start(port, "leader")
    assert port.clock.now() - begin == pytest.approx(3.0, abs=0.3)
