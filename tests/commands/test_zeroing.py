"""The procedure behind yam-zero when the bus or a motor does not play along."""

import threading
import time
from pathlib import Path

import can
import pytest
import yaml

from lerobot_robot_yam.arm import profile_files
from lerobot_robot_yam.commands.lib.zeroing import Zeroing
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import ConfigError, MotorError
from tests.support.crooked_arm import config, sent


def test_a_motor_that_is_enabled_behind_our_back_refuses(crooked):
    """The bus is our own, so the enable comes from the test: another computer could do the same."""
    with can.Bus(interface="yam_sim", channel="only", rig=crooked.name) as bus:
        zeroing = Zeroing(config(crooked), bus, ["joint_1"])
        zeroing.inspect()
        zeroing.require_still()
        bus.send(can.Message(arbitration_id=6, data=SpecialCommand.ENABLE.value, is_extended_id=False))
        crooked.trace_start("only")
        with pytest.raises(MotorError, match=r"left \(only\): joint_6 energised; zeroing is for limp motors"):
            zeroing.set_zero()
        assert sent(crooked) == []


def test_a_hand_may_move_a_limp_joint_as_far_as_it_likes(crooked):
    with can.Bus(interface="yam_sim", channel="only", rig=crooked.name) as bus:
        zeroing = Zeroing(config(crooked), bus, ["joint_1"])
        zeroing.inspect()
        before = zeroing.read().motor_rad[0]
        crooked.set_pose("only", q=[1.2, 0.6, 0.6, 0.0, 0.0, 0.0])
        assert abs(zeroing.read().motor_rad[0] - before) > 1.0


class MeddlingBus:
    """A bus on which something is wrong with ZERO frames: `meddle` maps each one to what really goes out."""

    def __init__(self, bus, meddle):
        self._bus, self._meddle = bus, meddle
        self.recv = lambda timeout_s: bus.recv(timeout_s)

    def send(self, message):
        self.send_many([message])

    def send_many(self, messages):
        for message in messages:
            out = self._meddle(message) if bytes(message.data) == SpecialCommand.ZERO.value else [message]
            for one in out:
                self._bus.send(one)


def zero_frame(can_id):
    return can.Message(arbitration_id=can_id, data=SpecialCommand.ZERO.value, is_extended_id=False)


@pytest.mark.parametrize(
    ("meddle", "message"),
    [
        (lambda frame: [], r"not zeroed: joint_1 reads 0.30. rad, joint_5 reads -0.* \(zeroed: none\)"),
        (lambda frame: [frame] if frame.arbitration_id == 1 else [], r"not zeroed: joint_5 .* \(zeroed: joint_1\)"),
        (lambda frame: [frame, zero_frame(3)], r"other motors changed too: joint_3 from 0.* to -?0.000 rad"),
    ],
    ids=["lost", "one lost", "another motor listens"],
)
def test_a_zero_that_did_not_do_what_it_should_is_an_error(crooked, meddle, message):
    with can.Bus(interface="yam_sim", channel="only", rig=crooked.name) as bus:
        zeroing = Zeroing(config(crooked), MeddlingBus(bus, meddle), ["joint_5", "joint_1"])
        zeroing.inspect()
        zeroing.require_still()
        with pytest.raises(MotorError, match=rf"left \(only\): .*{message}"):
            zeroing.set_zero()


@pytest.mark.parametrize("silent_s", [0.3, 60.0])
def test_a_motor_that_is_silent_while_it_writes_is_waited_for_and_then_named(crooked, silent_s):
    timers = []

    def meddle(frame):
        bus.send(frame)
        time.sleep(0.05)
        crooked.fault("only", "joint_1", "silent")
        timers.append(threading.Timer(silent_s, crooked.clear_faults, ["only"]))
        timers[-1].start()
        return []

    with can.Bus(interface="yam_sim", channel="only", rig=crooked.name) as bus:
        zeroing = Zeroing(config(crooked), MeddlingBus(bus, meddle), ["joint_1"])
        zeroing.inspect()
        zeroing.require_still()
        try:
            if silent_s < 1.0:
                zeroing.set_zero()
            else:
                with pytest.raises(
                    MotorError, match=r"zero was set, or not, of joint_1; then: .*no answer from joint_1"
                ):
                    zeroing.set_zero()
        finally:
            for timer in timers:
                timer.cancel()
                timer.join()


def test_a_range_without_zero_is_refused(crooked, tmp_path):
    packaged = Path(profile_files.__file__).parent / "profiles" / "arms" / "yam.yaml"
    document = yaml.safe_load(packaged.read_text())
    document["joint_limits_rad"][1] = [0.5, 3.0]
    for rest in document["rest_q_rad"].values():
        rest[1] = 0.5
    (tmp_path / "odd.yaml").write_text(yaml.safe_dump(document))
    with can.Bus(interface="yam_sim", channel="only", rig=crooked.name) as bus:
        with pytest.raises(ConfigError, match="the range 0.50 … 3.00 of joint_2 does not hold 0"):
            Zeroing(config(crooked, arm=str(tmp_path / "odd.yaml")), bus, ["joint_2"])
