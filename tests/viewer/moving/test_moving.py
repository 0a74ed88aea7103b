"""The page drives an arm of the virtual rig, asked by browsers through their WebSockets."""

import contextlib
import math
import time

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics, pose_errors
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.moving.control_desk import Stage
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.moving.driving_plan import plan_of
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support.rigged import sim_config
from tests.support.waiting import wait
from tests.viewer.conftest import ARM

JOINT = "joint_1, rad"
ROUND_S = 0.02


def enabled(rig):
    return [name for name, motor in rig.state()["arms"][ARM]["motors"].items() if motor["enabled"]]


def test_nothing_is_energised_before_a_person_has_confirmed(station, rig):
    browser = station.browser()
    for label, value in ((JOINT, 0.5), ("joint_2, rad", 1.0)):
        browser.set(label, value)
    for label in ("hold", "float", "land", "re-arm", "use these gains", "save the present pose", "take control"):
        browser.press(label)
    browser.drag_tool(ARM, [0.3, 0.0, 0.3], [1.0, 0.0, 0.0, 0.0])
    station.run(lambda: browser.was_told("press `connect …` and confirm it"))
    browser.press("connect …")
    browser.press("no")
    for _ in range(10):
        station.round()
    assert not enabled(rig) and station.driver.desk.stage is Stage.WATCHING
    browser.press("connect …")
    browser.press("energise")
    station.run(lambda: browser.was_told("the arms hold where they are"))
    assert len(enabled(rig)) == 7
    np.testing.assert_allclose(station.state.setpoint_q, rig.state()["arms"][ARM]["q"][:6], atol=0.02)


def test_a_slider_moves_its_joint_and_the_others_follow_the_arm(station, controlling):
    other, start = station.browser(), station.state.setpoint_q
    controlling.set(JOINT, 0.3)
    station.run(lambda: station.state.mode is Mode.HOLD and abs(station.state.q[0] - 0.3) < 0.02)
    np.testing.assert_allclose(station.state.q[1:], start[1:], atol=0.03)
    controlling.set("gripper, 0 closed, 1 open", 0.8)
    station.run(lambda: abs(station.state.gripper - 0.8) < 0.05)
    station.run(lambda: abs(other.value("joint_2, rad") - start[1]) < 0.01 and abs(other.value(JOINT) - 0.3) < 0.01)


def test_dragging_the_tool_moves_it(station, controlling):
    kinematics = YamKinematics("yam", "linear_4310")
    target = kinematics.fk(station.state.q)
    target[:3, 3] += [0.0, 0.05, 0.04]
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, target[:3, :3].ravel())
    controlling.drag_tool(ARM, target[:3, 3], quat)
    station.run(lambda: station.state.mode is Mode.TRACK)
    station.run(lambda: station.state.mode is Mode.HOLD)
    position_m, angle_rad = pose_errors(kinematics.fk(station.state.q), target)
    assert position_m < 0.01 and angle_rad < 0.03
    controlling.drag_tool(ARM, [3.0, 0.0, 0.3], quat)
    station.run(lambda: controlling.was_told("the tool cannot get there"))


def test_an_arm_is_held_back_from_itself_and_the_page_says_from_what(station, controlling):
    controlling.set("joint_5, rad", 1.57)
    words = f"{ARM} link3 – {ARM} gripper"
    station.run(lambda: controlling.was_told(f"held back: {words}"))
    station.run(lambda: controlling.shows(words))
    station.run(lambda: controlling.was_told("held back, and holds now") and station.state.mode is Mode.HOLD)
    assert 1.0 < station.state.q[4] < 1.32
    station.run(lambda: controlling.value("joint_5, rad") < 1.32)


def test_control_is_handed_over(station, controlling):
    other = station.browser()
    other.press("take control")
    station.run(lambda: controlling.was_told("asks for control") and other.was_told("has been asked"))
    other.set(JOINT, 0.4)
    station.run(lambda: other.was_told("browser 0 controls the arms"))
    assert station.state.mode is Mode.HOLD and station.driver.arms[ARM].goal is None
    controlling.press("give control")
    station.run(lambda: station.driver.desk.holder == 1)
    controlling.set(JOINT, -0.4)
    station.run(lambda: controlling.was_told("browser 1 controls the arms; press"))
    other.set(JOINT, 0.1)
    station.run(lambda: station.state.q[0] > 0.08)


@pytest.mark.parametrize("end", ["closed", "frozen"])
def test_the_arm_holds_when_the_browser_that_controls_it_is_lost_and_no_sooner(station, controlling, end):
    other, station.pace_s = station.browser(), ROUND_S
    controlling.set(JOINT, 3.0)
    station.run(lambda: station.state.q[0] > 0.9)
    if end == "closed":
        controlling.close()
    else:
        controlling.alive = False
    station.run(lambda: other.was_told("is lost: they hold"))
    assert station.state.mode is Mode.HOLD
    stopped = station.state.setpoint_q[0]
    assert stopped < 2.3
    station.take_control(other)
    np.testing.assert_allclose(station.state.setpoint_q[0], stopped, atol=0.1)


@pytest.mark.long
def test_an_arm_that_floats_holds_when_its_browser_is_lost(station, controlling):
    controlling.press("float")
    station.run(lambda: station.state.mode is Mode.FLOAT)
    controlling.close()
    station.run(lambda: station.state.mode is Mode.HOLD)


def test_what_cannot_be_is_refused_and_nothing_moves(station, controlling):
    before = station.state.setpoint_q
    for value in (math.nan, math.inf, 9.0, -9.0):
        controlling.set(JOINT, value)
    for position, quat in (
        ([math.nan, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]),
        ([0.3, 0.0, 0.3], [0.0, 0.0, 0.0, 0.0]),
        ([0.3, 0.0, 0.3], [1.0, 0.0, math.inf, 0.0]),
    ):
        controlling.drag_tool(ARM, position, quat)
    rounds(station, 0.3)
    with pytest.raises(ActionError, match="no motor 7"):
        station.driver.move(ARM, 7, 0.0)
    assert station.state.mode is Mode.HOLD
    np.testing.assert_array_equal(station.state.setpoint_q, before)


@pytest.mark.long
def test_what_has_waited_too_long_is_not_done(station, controlling):
    controlling.set(JOINT, 0.5)
    time.sleep(0.6)  # the driver's thread is busy
    station.run(lambda: controlling.was_told("the command is old"))
    assert station.driver.arms[ARM].goal is None


def rounds(station, seconds):
    until_s = time.monotonic() + seconds
    station.run(lambda: time.monotonic() > until_s)


def test_what_the_network_has_kept_is_not_done(station, controlling):
    before = station.state.setpoint_q
    controlling.stalled = True
    controlling.press("take control")
    controlling.set(JOINT, 0.5)
    station.run(lambda: controlling.was_told("is lost: they hold"))
    rounds(station, 0.3)
    controlling.stalled = False
    station.run(lambda: station.driver.desk.holder == 0)
    rounds(station, 0.2)
    assert controlling.was_told("nothing was done") and station.driver.arms[ARM].goal is None
    np.testing.assert_array_equal(station.state.setpoint_q, before)
    controlling.set(JOINT, 0.2)
    station.run(lambda: station.state.q[0] > 0.1)


def test_nothing_is_energised_by_a_confirmation_that_the_network_has_kept(station, rig):
    browser = station.browser()
    browser.press("connect …")
    station.run(lambda: "energise" in browser.labels())
    browser.stalled = True
    browser.press("energise")
    rounds(station, 0.6)
    browser.stalled = False
    station.run(lambda: browser.was_told("the command is old"))
    assert not enabled(rig) and station.driver.desk.stage is Stage.WATCHING


def test_other_browsers_cannot_make_the_commands_of_the_one_in_control_wait(station, controlling):
    other = station.browser()
    for number in range(50):
        other.set(JOINT, 0.001 * (number % 7))
        other.press("take control")
    wait(lambda: any("too many of your commands" in notice.text for notice in station.driver.notices), 10.0)
    assert len(list(station.driver._orders.of_a_round())) < 10
    controlling.set(JOINT, 0.2)
    station.run(lambda: station.state.q[0] > 0.1)


@pytest.mark.long
def test_an_emergency_stop_ends_the_way_to_a_goal_for_good(station, controlling):
    controlling.set(JOINT, 2.0)
    station.run(lambda: station.state.q[0] > 0.1)
    EmergencyStop().latch("test")
    station.run(lambda: controlling.was_told("the emergency stop is latched"))
    EmergencyStop().release()
    station.run(lambda: station.state.mode is Mode.HOLD)
    for _ in range(20):
        station.round()
    assert station.state.q[0] < 1.0 and station.state.mode is Mode.HOLD


@pytest.mark.long
def test_gains_are_changed_and_reset(station, controlling):
    client = station.driver.arms[ARM].client
    configured = client.kp.copy()
    controlling.set("kp joint_1", 40.0)
    controlling.press("use these gains")
    station.run(lambda: client.kp[0] == 40.0)
    controlling.set("kd joint_1", 0.0)
    controlling.press("use these gains")
    station.run(lambda: controlling.was_told("kd"))
    controlling.press("reset gains")
    station.run(lambda: client.kp[0] == configured[0])
    station.run(lambda: controlling.value("kp joint_1") == configured[0])


def test_what_another_browser_sets_is_put_back(station, controlling):
    other, client = station.browser(), station.driver.arms[ARM].client
    controlling.set("kp joint_1", 40.0)
    controlling.set("name", "mine")
    station.run(lambda: other.value("name") == "mine")
    other.set("kp joint_1", 20.0)
    other.set("name", "theirs")
    other.press("take control")
    station.run(lambda: other.was_told("has been asked"))
    controlling.press("use these gains")
    controlling.press("save the present pose")
    station.run(lambda: controlling.was_told("saved in") and controlling.value("pose") == "mine")
    assert client.kp[0] == 40.0 and controlling.value("kp joint_1") == 40.0


def test_a_pose_is_saved_and_gone_to_softly(station, controlling):
    controlling.set("name", "start")
    controlling.press("save the present pose")
    station.run(lambda: controlling.was_told("saved in"))
    start = station.state.q
    controlling.set(JOINT, 0.5)
    station.run(lambda: station.state.q[0] > 0.48)
    controlling.press("go to it")
    station.run(lambda: np.abs(station.state.q - start).max() < 0.01 and station.state.mode is Mode.HOLD)
    controlling.press("forget it")
    station.run(lambda: controlling.value("pose") == "(no pose is saved)")


@pytest.mark.long
def test_a_fault_is_shown_and_the_arm_is_rearmed(station, controlling, rig):
    controlling.set("motor", "joint_2")
    controlling.set("fault", "over-current (0xA)")
    controlling.press("set the fault")
    station.run(lambda: station.state.mode is Mode.FAULT)
    controlling.set(JOINT, 0.5)
    station.run(lambda: controlling.was_told(ARM))
    controlling.press("re-arm")
    station.run(lambda: station.state.mode is Mode.HOLD)


@pytest.mark.long
def test_things_of_the_virtual_rig_are_put_elsewhere(station, rig):
    browser = station.browser()
    browser.set("position, m", [0.4, 0.1, 0.03])
    browser.press("put it there")
    station.run(lambda: abs(rig.state()["props"]["cube"]["pos"][0] - 0.4) < 0.01)


@pytest.mark.long
def test_the_arm_lands_when_it_is_told_to_and_can_be_connected_again(station, controlling, rig):
    controlling.press("land")
    station.run(lambda: controlling.was_told("the arms have landed"))
    assert not enabled(rig) and station.driver.desk.stage is Stage.WATCHING
    station.take_control(controlling)
    assert len(enabled(rig)) == 7


def test_the_arm_lands_when_the_page_ends(station, controlling, rig):
    assert len(enabled(rig)) == 7
    station.moving.close()
    assert not enabled(rig)
    np.testing.assert_allclose(rig.state()["arms"][ARM]["q"][:3], 0.0, atol=0.05)


@pytest.mark.long
def test_arms_that_come_up_while_the_page_ends_are_not_waited_for(tmp_path):
    with running_rig(arms=[ARM]) as rig, contextlib.closing(Page(port=0)) as page:
        plan = plan_of([sim_config(rig, ARM, gripper_stops_rad=None)], tmp_path / "poses.json")
        driver, stops = Driver(plan, page.server), []

        def connect():
            driver.connect()
            stops.append(driver.arms[ARM].client.published().gripper_stops_rad)

        with contextlib.closing(driver):
            driver.ask_freely(0, connect)
            driver.start()
            while not enabled(rig):  # its gripper seeks its stops then
                time.sleep(0.01)
        assert not enabled(rig)
        assert stops in ([], [None])  # they were not found
