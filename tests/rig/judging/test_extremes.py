"""Extremes of its arms that the rig itself records."""

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.client.rig_control import RigControl, running_rig
from lerobot_robot_yam.rig.simulation import rig_commands
from tests.support.rig_desk import Desk

CHANNEL = "follower_left"
WRIST = 6


@pytest.fixture
def desk():
    desk = Desk(friction=0)
    yield desk
    desk.close()


def watch(desk, **details):
    return rig_commands.ask(desk.device, {"op": "watch", "channel": CHANNEL, **details})


def test_recording_is_off_by_default(desk):
    desk.run(0.05)
    assert not desk.device.watch.on
    with pytest.raises(ConfigError, match="watch_start"):
        watch(desk)


def test_the_largest_speed_and_torque_are_kept_with_their_times(desk):
    watch(desk, start=True)
    desk.special(WRIST, SpecialCommand.ENABLE)
    speeds, torques, began = [], [], desk.now_s
    for tick in range(120):
        feedback = desk.mit(WRIST, q=0.8 if tick < 60 else 0.0, kp=8, kd=0.4)
        desk.run(0.004)
        speeds.append(abs(feedback.velocity))
        torques.append(abs(feedback.torque))
    found = watch(desk)
    assert found["motors"][5] == "joint_6"
    assert found["max_speed_rad_s"][5] == pytest.approx(max(speeds), rel=0.03)
    assert found["max_torque_nm"][5] == pytest.approx(8 * 0.8, rel=0.05) and max(torques) < 5.0  # a tick later
    assert found["max_speed_at_s"][5] == pytest.approx(began + 0.004 * np.argmax(speeds), abs=0.013)
    assert found["max_torque_at_s"][5] == pytest.approx(began + 0.004 * np.argmax(torques), abs=0.007)
    watch(desk, start=True)  # anew
    assert not np.any(watch(desk)["max_speed_rad_s"])


def test_a_short_peak_between_two_looks_of_a_client_is_not_missed(desk):
    desk.special(WRIST, SpecialCommand.ENABLE)
    watch(desk, start=True)
    desk.mit(WRIST, tau=3.0)
    desk.run(0.008)
    desk.mit(WRIST, kd=0.05)
    desk.run(0.3)
    assert abs(desk.mit(WRIST).velocity) < 0.5
    assert watch(desk)["max_torque_nm"][5] == pytest.approx(3.0, rel=0.05)
    assert watch(desk)["max_speed_rad_s"][5] > 1.0


def test_the_longest_that_a_motor_acts_on_one_command_is_kept(desk):
    watch(desk, start=True)
    desk.run(0.1)
    assert not np.any(watch(desk)["max_command_age_s"])  # it is not enabled
    desk.special(WRIST, SpecialCommand.ENABLE)
    for pause_s in (0.004, 0.03, 0.004):
        desk.mit(WRIST, kd=0.05)
        desk.run(pause_s)
    age = watch(desk)["max_command_age_s"]
    assert age[5] == pytest.approx(0.03, abs=0.005)
    assert not np.any(np.delete(age, 5))


def test_speed_counts_under_torque_only(desk):
    desk.device.world.set_pose(CHANNEL, np.array([0, 1.5, 1.0, 0, 0, 0]))
    watch(desk, start=True)
    desk.run(0.2)  # it falls, limp
    found = watch(desk)
    assert not np.any(found["max_speed_rad_s"])
    assert found["max_tcp_drop_m"] > 0.02
    assert found["min_tcp_z_m"] > 0.0
    for can_id in range(1, 8):
        desk.special(can_id, SpecialCommand.ENABLE)
    desk.run(0.02)
    assert watch(desk)["max_speed_rad_s"][1] > 0.2  # still falling, now with torque on


def test_a_touch_is_noticed(desk):
    desk.device.world.set_pose(CHANNEL, np.array([0, 1.5, 1.0, 0, 0, 0]))
    watch(desk, start=True)
    desk.run(0.05)
    assert watch(desk)["touched_at_s"] == 0.0
    desk.run(2.0)  # limp, down to the table
    assert watch(desk)["touched_at_s"] > desk.now_s - 1.0


def test_an_arm_that_presses_on_itself_touches_and_one_whose_wrist_lies_does_not(desk):
    watch(desk, start=True)
    desk.run(0.5)  # folded and limp
    assert watch(desk)["touched_at_s"] == 0.0
    desk.special(4, SpecialCommand.ENABLE)
    desk.mit(4, q=-1.0, kp=40, kd=1.5)  # the wrist, down onto the shoulder's motor
    desk.run(0.2)
    assert watch(desk)["touched_at_s"] == pytest.approx(desk.now_s, abs=0.01)


def test_the_height_is_the_true_one(desk):
    world = desk.device.world
    watch(desk, start=True)
    before = float(world.data.site(f"{CHANNEL}/tcp_site").xpos[2])
    desk.run(0.1)
    heights = [float(world.data.site(f"{CHANNEL}/tcp_site").xpos[2])]
    found = watch(desk)
    assert found["min_tcp_z_m"] <= min(before, *heights) + 1e-9
    assert found["max_tcp_drop_m"] == pytest.approx(before - found["min_tcp_z_m"])


def test_motors_that_come_and_go_are_listed(desk):
    watch(desk, start=True)
    desk.special(WRIST, SpecialCommand.ENABLE)
    desk.special(WRIST, SpecialCommand.DISABLE)
    desk.special(2, SpecialCommand.ENABLE)
    desk.run(0.45)
    found = watch(desk)
    events = [(motor, enabled) for _, motor, enabled in found["enabled_events"]]
    assert events == [("joint_6", True), ("joint_6", False), ("joint_2", True), ("joint_2", False)]
    assert [(motor, code) for _, motor, code in found["fault_events"]] == [("joint_2", 0xD)]
    desk.motor(2).fail(0xE)  # another fault of a motor that is off already
    again = watch(desk)
    assert again["enabled_events"] == found["enabled_events"]
    assert [code for _, _, code in again["fault_events"]] == [0xD, 0xE]
    watch(desk, stop=True)
    desk.special(WRIST, SpecialCommand.ENABLE)
    assert watch(desk)["enabled_events"] == found["enabled_events"]


def test_other_channels_are_left_alone():
    with running_rig() as rig:
        rig.watch_start("follower_right")
        rig.watch_start("leader_left")
        found = rig.watch("follower_right")
        assert len(found["max_speed_rad_s"]) == len(found["max_torque_nm"]) == 7
        assert len(rig.watch("leader_left")["motors"]) == 6
        with pytest.raises(ConfigError, match="follower_left is not watched"):
            rig.watch("follower_left")


def test_many_changes_reach_the_client():
    with running_rig(arms=[CHANNEL]) as rig:
        rig.watch_start(CHANNEL)
        _blink(rig, 300)
        events = rig.watch(CHANNEL)["enabled_events"]
        assert [enabled for _, _, enabled in events] == ([True] * 7 + [False] * 7) * 300
        assert all(isinstance(event, tuple) for event in events)
        assert [at for at, _, _ in events] == sorted(at for at, _, _ in events)


def _blink(rig: RigControl, times: int) -> None:
    with can.Bus(interface="yam_sim", channel=CHANNEL, rig=rig.name) as bus:
        for _ in range(times):
            for command in (SpecialCommand.ENABLE, SpecialCommand.DISABLE):
                bus.send_many(
                    [can.Message(arbitration_id=i, data=command.value, is_extended_id=False) for i in range(1, 8)]
                )
                for _ in range(7):
                    assert bus.recv(5.0) is not None
