"""The controller with an arm on the virtual rig, over CAN frames: what Commander does unasked moves nothing; the arm is
held whatever happens."""

import asyncio
import itertools
import random

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import seeks_stops
from lerobot_robot_yam.errors import ControllerError, YamError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.waldo.controller.controller_process import operator_acts
from scripts import recorders
from tests.support.rigged import lockstep_rig
from tests.support.tiers import spread
from tests.support.waldo_desk import waldo_desk

ARM = "follower_left"
LONG = pytest.mark.long
POSE = [0.1, 0.9, 0.9, -0.3, 0.1, 0.1]
UNASKED = [
    ("ping", {}), ("reset", {}), ("simulator", {"enabled": False}), ("simulator", {"enabled": True}),
    ("select_profile", {"profile": "TOPPRA"}), ("select_profile", {"profile": "ruckig"}),
    ("select_tool", {"tool_name": "LINEAR_4310"}), ("select_tool", {"tool_name": "NONE"}),
    ("connect_hardware", {"port_str": ARM}), ("connect_hardware", {"port_str": "can7"}), ("tools", {}),
]  # fmt: skip
LONGER = [[0, 120, 0, 0, 0, 0], [-60, 60, 40, 0, 0, 0]]
LINE_M = 2e-3
FORCE_LIMIT_NM = 1.03 * 1.1  # of the gripper's motor: 50 N and its friction, and a tenth for measuring
STILL_RAD_S = np.radians(2.0)
SETTLE_S = 4.0  # in which the arm's own loop makes up for its sag

rig = lockstep_rig(ARM)


@pytest.fixture
def desk(rig):
    rig.set_pose(ARM, POSE, 0.5)
    with waldo_desk(rig, ARM) as desk:
        yield desk


def true_q(rig):
    return np.array(rig.state()["arms"][ARM]["q"])[:6]


def tried(desk, name, arguments):
    try:
        return desk.ask(name, **arguments)
    except YamError:
        return None


def extremes(rig):
    """Of the six joints since `watch_start`."""
    return np.array(recorders.watch(rig, ARM)["max_speed_rad_s"])[:6]


def test_nothing_unasked_reaches_the_motors_before_an_operator_has_armed(rig, desk):
    rig.trace_start(ARM)
    recorders.watch_start(rig, ARM)
    calls = UNASKED * 3
    random.Random(1).shuffle(calls)
    for name, arguments in [*UNASKED, *calls]:
        tried(desk, name, arguments)
        desk.run(0.02)
        assert not desk.ask("ping")["hardware_connected"] and desk.ask("ping")["simulator"]
    with pytest.raises(ControllerError, match="it is not armed; at its computer: yam-waldo arm"):
        desk.ask("simulator", enabled=False)
    assert rig.trace(ARM) == [] and recorders.watch(rig, ARM)["enabled_events"] == []
    assert max(recorders.watch(rig, ARM)["max_torque_nm"]) == 0.0


def test_taking_over_holds_the_measured_pose_whatever_the_simulator_showed(rig, desk):
    desk.ask("teleport", angles_deg=[90, 100, 40, 20, 30, 40], tool_positions=[0.9])
    desk.ask("move_j", angles=[0, 60, 60, -29, 0, 0])
    desk.real.arm()
    desk.run(SETTLE_S)
    before = true_q(rig)
    recorders.watch_start(rig, ARM)
    assert desk.ask("ping")["hardware_connected"]
    desk.ask("simulator", enabled=False)
    desk.ask("reset")
    desk.run(1.5)
    assert np.abs(true_q(rig) - before).max() < np.radians(0.3)
    assert extremes(rig).max() < STILL_RAD_S
    status = desk.ask("status")
    np.testing.assert_allclose(np.radians(status["angles"]), true_q(rig), atol=2e-3)
    assert not status["simulator_active"] and status["executing_index"] == -1 and desk.ask("queue") == []


@pytest.mark.parametrize("stop, seconds", spread([("estop", 5.0), ("stop", 2.0), ("estop", 60.0)], 0))
def test_a_stop_is_quick_and_then_the_arm_is_held(rig, desk, stop, seconds):
    desk.drive()
    desk.run(0.5)
    index = desk.ask("move_j", angles=[60, 60, 60, -20, 0, 0], speed=0.3)
    desk.run(1.0)
    assert np.abs(desk.controller.reading.dq).max() > 0.3
    desk.ask(stop)
    desk.run(0.5)
    held = true_q(rig)
    recorders.watch_start(rig, ARM)
    desk.run(seconds)
    assert np.abs(true_q(rig) - held).max() < np.radians(1.0) and extremes(rig).max() < STILL_RAD_S
    assert recorders.watch(rig, ARM)["enabled_events"] == []
    assert desk.ask("wait_command", command_index=index) is False
    held = true_q(rig)
    desk.ask("reset")
    desk.run(1.0)
    assert np.abs(true_q(rig) - held).max() < np.radians(0.1)
    last = desk.ask("move_j", angles=[10, 60, 60, -20, 0, 0])
    desk.run(4.0)
    assert desk.ask("wait_command", command_index=last) is True and desk.ask("wait_motion") is True
    np.testing.assert_allclose(np.degrees(true_q(rig)), [10, 60, 60, -20, 0, 0], atol=1.0)


def test_an_estop_holds_against_all_who_go_on_sending(rig, desk):
    desk.drive()
    desk.run(SETTLE_S)
    desk.ask("estop")
    desk.run(0.3)
    held = true_q(rig)
    for name, arguments in (
        ("move_j", {"angles": [0, 60, 60, -29, 0, 0]}), ("home", {}), ("servo_j", {"angles": [0, 60, 60, -29, 0, 0]}),
        ("jog_j", {"joints": [0], "speeds": [0.5]}), ("move_l", {"pose": [0, 0, 20, 0, 0, 0], "rel": True}),
        ("jog_l", {"frame": "WRF", "axes": ["Z"], "speeds": [0.5]}), ("delay", {"seconds": 0.1}),
        ("tool_action", {"tool_key": "LINEAR_4310", "action": "close"}),
    ):  # fmt: skip
        with pytest.raises(ControllerError, match="an e-stop is latched: the arm holds"):
            desk.ask(name, **arguments)
    desk.run(0.5)
    assert np.abs(true_q(rig) - held).max() < np.radians(0.1)


def test_no_teleport_reaches_a_motor(rig, desk):
    desk.real.arm()
    desk.run(SETTLE_S)
    held, numbers = true_q(rig), random.Random(2)
    recorders.watch_start(rig, ARM)
    setpoints = []
    for _ in range(20):
        for mode, _ in itertools.product((False, True), range(5)):
            angles = [numbers.uniform(5, 80) for _ in range(6)]
            tried(desk, "teleport", {"angles_deg": angles, "tool_positions": [numbers.random()]})
            tried(desk, "simulator", {"enabled": mode})
            tried(desk, "teleport", {"angles_deg": angles})
            setpoints.append(desk.real.client.published().setpoints)
    with pytest.raises(ControllerError, match="commands move the real arm now; nothing moves"):
        desk.ask("simulator", enabled=False)
        desk.ask("teleport", angles_deg=[0, 60, 60, -29, 0, 0])
    assert np.ptp(setpoints, axis=0).max() < 1e-4
    assert np.abs(true_q(rig) - held).max() < np.radians(0.2) and extremes(rig).max() < STILL_RAD_S


def test_a_cable_that_comes_off_stops_the_move_and_resume_waits_for_frames(rig, desk):
    desk.drive()
    index = desk.ask("move_j", angles=[60, 60, 60, -20, 0, 0], speed=0.3)
    desk.run(1.0)
    rig.fault(ARM, None, "cable_out")
    desk.run(0.5)
    status = desk.ask("status")
    assert not status["enabled"] and status["warnings"] and status["error"] is not None
    assert not desk.ask("ping")["hardware_connected"] and desk.ask("wait_command", command_index=index) is False
    assert desk.ask("estop") == 1  # its button never fails
    with pytest.raises(ControllerError, match="takes no commands yet"):
        desk.ask("reset")
    rig.clear_faults(ARM)
    desk.run(1.0)
    desk.real.arm()  # `yam-waldo arm` after a look at it
    desk.run(0.5)
    held = true_q(rig)
    assert desk.ask("reset") == 1
    desk.run(0.5)
    assert np.abs(true_q(rig) - held).max() < np.radians(0.3) and desk.ask("status")["enabled"]


@pytest.mark.long
def test_an_arm_gets_up_from_where_it_rests_a_little_outside_its_limits(rig, desk):
    rig.set_pose(ARM, [0.0, -0.004, -0.003, -0.1666, 0.0, 0.0], 0.5)
    desk.drive()
    desk.run(0.5)
    for joint in (1, 2):
        desk.ask("jog_j", joints=[joint], speeds=[0.6], duration=0.8)
        desk.run(1.5)
    assert np.degrees(true_q(rig))[1:3].min() > 5.0
    index = desk.ask("home")
    desk.carry_out(index)
    assert desk.ask("wait_command", command_index=index) is True
    np.testing.assert_allclose(np.degrees(true_q(rig)), [0, 60, 60, -29, 0, 0], atol=1.5)


@pytest.mark.long
@pytest.mark.parametrize("way", [[60, 60, -60, 0, 0, 0], *(pytest.param(way, marks=LONG) for way in LONGER)])
def test_a_line_is_straight_on_the_rig(rig, desk, way):
    desk.drive()
    desk.ask("select_tool", tool_name="linear_4310")
    desk.carry_out(desk.ask("move_j", angles=[0, 70, 60, -60, 0, 0]))
    desk.run(SETTLE_S)
    planner, rows = desk.controller.planner, []
    begin = planner.pose(true_q(rig))[:3, 3]
    index = desk.ask("move_l", pose=way, rel=True, speed=1.0)
    while desk.controller.motion.end_of(index) is None:
        desk.run(0.01)
        rows.append(planner.pose(true_q(rig))[:3, 3])
    along = np.array(way[:3]) / np.linalg.norm(way[:3])
    off = np.linalg.norm(np.cross(np.array(rows) - begin, along), axis=1)
    assert off.max() < LINE_M and np.linalg.norm(rows[-1] - begin) > 0.9e-3 * np.linalg.norm(way[:3])


def test_a_hand_moves_the_arm_while_it_floats_and_it_holds_there(rig, desk):
    with pytest.raises(ControllerError, match="freedrive is for the real arm"):
        desk.ask("freedrive", enabled=True)
    desk.drive()
    desk.ask("freedrive", enabled=True)
    desk.run(0.2)
    assert desk.ask("status")["freedrive"] and desk.ask("ping")["hardware_connected"]
    with pytest.raises(ControllerError, match="the arm floats"):
        desk.ask("home")
    rig.push(ARM, "tool", [0.0, 4.0, 0.0], 0.5)
    desk.run(1.0)
    moved = true_q(rig)
    assert abs(moved[0] - POSE[0]) > 0.05
    desk.ask("estop")
    desk.run(1.0)
    assert np.abs(true_q(rig) - moved).max() < np.radians(2.0) and not desk.ask("status")["freedrive"]
    desk.ask("reset")
    desk.ask("freedrive", enabled=True)
    desk.run(0.2)
    desk.ask("simulator", enabled=True)  # which ends it, too
    desk.run(0.2)
    assert desk.real.client.published().mode is Mode.HOLD


@pytest.mark.long
def test_what_is_gripped_is_seen_and_pressed_with_no_more_than_the_force_limit(rig, desk):
    desk.drive()
    desk.ask("select_tool", tool_name="linear_4310")
    desk.carry_out(desk.ask("tool_action", tool_key="LINEAR_4310", action="open"))
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.array(rig.state()["arms"][ARM]["grasp_site"]["mat"]))
    index = desk.ask("tool_action", tool_key="LINEAR_4310", action="close")
    while desk.controller.reading.grip_nm < 0.6 and desk.controller.motion.end_of(index) is None:
        rig.place("cube", rig.state()["arms"][ARM]["grasp_site"]["pos"], quat)  # a hand holds it there
        desk.run(0.01)
    desk.run(0.5)
    recorders.watch_start(rig, ARM)
    desk.run(1.5)
    assert 0.3 < recorders.watch(rig, ARM)["max_torque_nm"][-1] < FORCE_LIMIT_NM
    assert desk.ask("wait_command", command_index=index) is True
    tool = desk.ask("status")["tool"]
    assert tool["part_detected"] and 0.3 < tool["positions"][0] < 0.9


def test_the_emergency_stop_of_the_machine_counts_here_too(rig, desk):
    desk.drive()
    desk.ask("move_j", angles=[60, 60, 60, -20, 0, 0], speed=0.3)
    desk.run(1.0)
    EmergencyStop().latch("a test")
    desk.run(0.5)
    held = true_q(rig)
    assert "the emergency stop is latched" in desk.ask("status")["error"][2]
    with pytest.raises(ControllerError, match="`yam-estop release` ends it"):
        desk.ask("reset")
    EmergencyStop().release()
    desk.run(0.5)
    assert desk.ask("reset") == 1
    desk.run(0.5)
    assert np.abs(true_q(rig) - held).max() < np.radians(0.5)
    desk.carry_out(desk.ask("home"))
    np.testing.assert_allclose(np.degrees(true_q(rig)), [0, 60, 60, -29, 0, 0], atol=1.5)


def test_it_is_known_before_whether_the_gripper_will_seek_its_stops(tmp_path):
    stops = tmp_path / "stops.json"
    for fields, seeks in (
        ({}, True), ({"gripper": "no_gripper"}, False), ({"gripper_search": False}, False),
        ({"gripper_stops_rad": [3.2, -3.3]}, False), ({"calibration_path": str(stops)}, True),
    ):  # fmt: skip
        assert seeks_stops(ArmConfig(channel="can7", **fields)) == seeks
    stops.write_text("{}")
    assert not seeks_stops(ArmConfig(channel="can7", calibration_path=str(stops)))


def test_the_gripper_is_open_at_0_and_closed_at_1(rig, desk):
    desk.drive()
    desk.ask("select_tool", tool_name="linear_4310")
    for action, opening in (("open", 1.0), ("close", 0.0)):
        index = desk.ask("tool_action", tool_key="LINEAR_4310", action=action)
        desk.run(2.0)
        assert desk.ask("wait_command", command_index=index) is True
        assert rig.state()["arms"][ARM]["opening"] == pytest.approx(opening, abs=0.05)
        assert desk.ask("status")["tool"]["positions"] == [pytest.approx(1.0 - opening, abs=0.05)]


@LONG
def test_an_arm_that_an_emergency_stop_keeps_in_the_air_has_not_landed(desk):
    desk.drive()
    EmergencyStop().latch("a test")
    try:
        with pytest.raises(ControllerError, match="STILL IN THE AIR"):
            asyncio.run(operator_acts(desk.controller)["land"]())
    finally:
        EmergencyStop().release()
