"""Recorders that run in the rig's own process: extremes of its arms, and true samples of every step of the physics."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from scripts import recorders
from tests.support.rig_desk import Desk

CHANNEL = "follower_left"
WRIST = 6
FALLING = np.array([0, 1.5, 1.0, 0, 0, 0])


@pytest.fixture
def desk():
    with contextlib.closing(Desk(friction=0)) as desk:
        yield desk


@pytest.fixture
def watched(desk):
    recorders.watch_start(desk, CHANNEL)
    return desk


def watch(desk):
    return recorders.watch(desk, CHANNEL)


def test_the_largest_speed_and_torque_are_kept_with_their_times(watched):
    watched.special(WRIST, SpecialCommand.ENABLE)
    speeds, torques, began = [], [], watched.now_s
    for tick in range(120):
        feedback = watched.mit(WRIST, q=0.8 if tick < 60 else 0.0, kp=8, kd=0.4)
        watched.run(0.004)
        speeds.append(abs(feedback.velocity))
        torques.append(abs(feedback.torque))
    found = watch(watched)
    assert found["motors"][5] == "joint_6"
    assert found["max_speed_rad_s"][5] == pytest.approx(max(speeds), rel=0.03)
    assert found["max_torque_nm"][5] == pytest.approx(8 * 0.8, rel=0.05) and max(torques) < 5.0  # a tick later
    assert found["max_speed_at_s"][5] == pytest.approx(began + 0.004 * np.argmax(speeds), abs=0.013)
    recorders.watch_start(watched, CHANNEL)  # anew
    assert not np.any(watch(watched)["max_speed_rad_s"])


def test_the_longest_that_a_motor_acts_on_one_command_is_kept(watched):
    watched.run(0.1)
    assert not np.any(watch(watched)["max_command_age_s"])  # it is not enabled
    watched.special(WRIST, SpecialCommand.ENABLE)
    for pause_s in (0.004, 0.03, 0.004):
        watched.mit(WRIST, kd=0.05)
        watched.run(pause_s)
    age = watch(watched)["max_command_age_s"]
    assert age[5] == pytest.approx(0.03, abs=0.005)
    assert not np.any(np.delete(age, 5))


def test_speed_counts_under_torque_only_and_a_touch_and_a_fall_are_noticed(desk):
    desk.device.world.set_pose(CHANNEL, FALLING)
    recorders.watch_start(desk, CHANNEL)
    before = float(desk.device.world.data.site(f"{CHANNEL}/tcp_site").xpos[2])
    desk.run(0.05)  # it falls, limp
    assert watch(desk)["touched_at_s"] == 0.0
    desk.run(0.15)
    found = watch(desk)
    assert not np.any(found["max_speed_rad_s"])
    height = float(desk.device.world.data.site(f"{CHANNEL}/tcp_site").xpos[2])
    assert found["max_tcp_drop_m"] == pytest.approx(before - height, abs=0.01) and before - height > 0.02
    for can_id in range(1, 8):
        desk.special(can_id, SpecialCommand.ENABLE)
    desk.run(0.02)
    assert watch(desk)["max_speed_rad_s"][1] > 0.2  # still falling, now with torque on
    desk.run(2.0)  # limp, down to the table
    assert watch(desk)["touched_at_s"] > desk.now_s - 1.0


def test_an_arm_that_presses_on_itself_touches_and_one_whose_wrist_lies_does_not(watched):
    watched.run(0.5)  # folded and limp
    assert watch(watched)["touched_at_s"] == 0.0
    watched.special(4, SpecialCommand.ENABLE)
    watched.mit(4, q=-1.0, kp=40, kd=1.5)  # the wrist, down onto the shoulder's motor
    watched.run(0.2)
    assert watch(watched)["touched_at_s"] == pytest.approx(watched.now_s, abs=0.01)


def test_motors_that_come_and_go_are_listed(watched):
    watched.special(WRIST, SpecialCommand.ENABLE)
    watched.special(WRIST, SpecialCommand.DISABLE)
    watched.special(2, SpecialCommand.ENABLE)
    watched.run(0.45)
    found = watch(watched)
    events = [(motor, enabled) for _, motor, enabled in found["enabled_events"]]
    assert events == [("joint_6", True), ("joint_6", False), ("joint_2", True), ("joint_2", False)]
    assert [(motor, code) for _, motor, code in found["fault_events"]] == [("joint_2", 0xD)]
    watched.motor(2).fail(0xE)  # another fault of a motor that is off already
    again = watch(watched)
    assert again["enabled_events"] == found["enabled_events"]
    assert [code for _, _, code in again["fault_events"]] == [0xD, 0xE]


def test_every_step_is_kept_only_the_last_ones_and_anew_at_each_start():
    with contextlib.closing(LockstepRig(arms=[CHANNEL], friction=0)) as rig:
        recorders.truth_start(rig, CHANNEL, 0.5)
        rig.sleep(0.8)
        truth = recorders.truth(rig, CHANNEL)
        assert truth["stamp_s"].shape == (500,) and truth["q"].shape == truth["dq"].shape == (500, 7)
        assert truth["torque_nm"].shape == truth["asked_nm"].shape == (500, 7)
        assert np.diff(truth["stamp_s"]) == pytest.approx(0.001)
        assert truth["stamp_s"][-1] == pytest.approx(rig.now(), abs=0.0011)
        assert truth["q"][-1, :6] == pytest.approx(rig.state()["arms"][CHANNEL]["q"])
        assert len(recorders.truth(rig, CHANNEL, rig.now() - 0.1)["stamp_s"]) == pytest.approx(100, abs=2)
        recorders.truth_start(rig, CHANNEL)
        assert len(recorders.truth(rig, CHANNEL)["stamp_s"]) == 0
        recorders.truth_stop(rig, CHANNEL)
        with pytest.raises(ConfigError, match="truth_start"):
            recorders.truth(rig, CHANNEL)


def test_looking_changes_nothing():
    def swing(looked):
        with contextlib.closing(Desk(friction=0)) as desk:
            if looked:
                recorders.truth_start(desk, CHANNEL)
                recorders.watch_start(desk, CHANNEL)
            desk.special(WRIST, SpecialCommand.ENABLE)
            found = []
            for _ in range(50):
                found.append(desk.mit(WRIST, tau=1.0))
                desk.run(0.008)
            return found

    assert swing(True) == swing(False)


def test_asked_torque_is_reported_beside_applied_torque(watched):
    recorders.truth_start(watched, CHANNEL)
    watched.special(WRIST, SpecialCommand.ENABLE)
    watched.special(7, SpecialCommand.ENABLE)
    kp, kd = 163 * 500 / 4095, 1638 * 5 / 4095  # what a frame can hold
    watched.mit(WRIST, q=2.0, dq=1.0, kp=kp, kd=kd, tau=1.5)
    watched.mit(7, tau=3.0)
    watched.run(0.02)
    truth = recorders.truth(watched, CHANNEL)
    for q, dq, torque, asked in zip(
        truth["q"][:-1, 5], truth["dq"][:-1, 5], truth["torque_nm"][1:, 5], truth["asked_nm"][1:, 5], strict=True
    ):
        expected = kp * (2.0 - q) + kd * (1.0 - dq) + 1.5
        assert asked == pytest.approx(expected, abs=0.05)
        assert torque == pytest.approx(np.clip(expected, -10.0, 10.0), abs=0.05)
    assert truth["asked_nm"][-1, 6] == pytest.approx(3.0, abs=0.01)  # the gripper's drive is a tendon
    assert truth["asked_nm"][:, 5].max() > 30.0
    seen = watch(watched)
    assert seen["max_torque_nm"][5] == pytest.approx(10.0)
    assert seen["max_asked_nm"][5] > 30.0
    assert seen["max_asked_at_s"][5] == pytest.approx(watched.now_s - 0.016, abs=0.005)


def test_a_stamped_sample_tells_its_age(desk):
    recorders.stamp_temperatures(desk)
    feedback = desk.special(1, SpecialCommand.ENABLE)
    received = desk.now_s + 2 * 130e-6  # the sample was taken when the command arrived, one frame earlier
    age_s = recorders.sample_age_s(feedback.temp_mos, feedback.temp_rotor, received + 0.01)
    assert age_s == pytest.approx(0.0101, abs=2e-4)
