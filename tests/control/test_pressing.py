"""An arm that something blocks: what stops it lets it press less, and what frees it is not thrown at."""

import numpy as np
import pytest

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.support.rigged import lockstep_rig, session_on, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
NEAR = [0.0, 1.0, 1.2, 0.0, 0.0, 0.0]
FAR = [0.6, 1.0, 1.2, 0.0, 0.0, 0.0]


rig = lockstep_rig(CHANNEL)


@pytest.fixture
def running(rig):
    sessions = []

    def start(**changes):
        session = session_on(rig, sim_config(rig, CHANNEL, **changes))
        session.start()
        sessions.append(session)
        return session

    yield start
    EmergencyStop().release()
    for session in sessions:
        session.discard()


def press(rig, session, seconds=1.0):
    """Wind joint_1 up against something."""
    track(session, {CHANNEL: NEAR}, 1.2)
    rig.fault(CHANNEL, "joint_1", "stuck")
    track(session, {CHANNEL: FAR}, seconds)


def pull_nm(session):
    """Of joint_1's stiffness; an arm in trouble cannot be observed."""
    state = session[CHANNEL].published()
    return 80.0 * abs(state.setpoints[0] - state.positions[0])


def fastest(rig):
    return max(recorders.watch(rig, CHANNEL)["max_speed_rad_s"][:6])


@pytest.mark.parametrize("wrist", spread([-0.2, -0.6], 1))
def test_an_elbow_opens_under_a_wrist_that_leans_on_the_shoulder(rig, running, wrist):
    session = running()
    recorders.watch_start(rig, CHANNEL)
    track(session, {CHANNEL: [0.0, 0.0, 1.2, wrist, 0.0, 0.0]}, 1.5)
    state = session[CHANNEL].observe()
    assert abs(state.q[2] - 1.2) < 0.1 and not state.limited & Limited.CAME_FREE
    assert fastest(rig) < 1.1 * 1.5


@pytest.mark.long
def test_who_presses_on_something_says_so_once(rig, running, caplog):
    session = running()
    press(rig, session, 3.0)
    told = [record.message for record in caplog.records if "in its way" in record.message]
    assert len(told) == 1 and "joint_1 is 0.6" in told[0]


def test_an_emergency_stop_ends_the_pressing(rig, running):
    session = running()
    press(rig, session)
    assert pull_nm(session) > 20.0
    EmergencyStop().latch("somebody is in there")
    session.clock.sleep(0.1)
    assert session[CHANNEL].mode() is Mode.STOPPED and pull_nm(session) < 5.2
    assert abs(session[CHANNEL].observe().tau_nm[0]) < 6.0


def test_an_emergency_stop_counts_what_a_hold_has_added(rig, running):
    session = running()
    track(session, {CHANNEL: NEAR}, 1.2)
    rig.fault(CHANNEL, "joint_1", "stuck")
    track(session, {CHANNEL: [0.08, *NEAR[1:]]}, 0.5)
    session[CHANNEL].hold()
    session.clock.sleep(3.0)
    assert abs(session[CHANNEL].observe().tau_nm[0]) > 8.0
    EmergencyStop().latch("somebody is in there")
    session.clock.sleep(0.1)
    assert abs(session[CHANNEL].observe().tau_nm[0]) < 5.5


@pytest.mark.long
def test_an_arm_in_trouble_is_no_exception(rig, running):
    """Nor is it locked up: it was stopped for an effort that it went on making."""
    session = running(effort_limit_nm=[30.0, 45.0, 45.0, 20.0, 20.0, 20.0])
    press(rig, session)
    rig.fault(CHANNEL, "joint_6", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.2)
    assert session[CHANNEL].mode() is Mode.FAULT and pull_nm(session) > 20.0
    EmergencyStop().latch("somebody is in there")
    session.clock.sleep(0.2)
    assert pull_nm(session) < 5.2
    EmergencyStop().release()
    session.clock.sleep(0.1)
    session[CHANNEL].rearm()
    assert session[CHANNEL].mode() is Mode.HOLD


@pytest.mark.long
def test_an_arm_in_trouble_presses_less_at_the_second_stop_too(rig, running):
    session = running()
    track(session, {CHANNEL: NEAR}, 1.2)
    rig.fault(CHANNEL, "joint_6", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    EmergencyStop().latch("a test")
    session.clock.sleep(0.1)
    EmergencyStop().release()
    session.clock.sleep(0.1)
    assert Limited.EMERGENCY_STOP not in session[CHANNEL].published().limited
    rig.push(CHANNEL, "link4", [0.0, 60.0, 0.0], 0.5)
    session.clock.sleep(0.4)
    rig.fault(CHANNEL, "joint_1", "stuck")  # where it was pushed to
    session.clock.sleep(0.3)
    assert session[CHANNEL].mode() is Mode.FAULT and pull_nm(session) > 10.0
    EmergencyStop().latch("somebody is in there")
    session.clock.sleep(0.1)
    assert pull_nm(session) < 5.2


def test_what_the_effort_limit_has_stopped_can_be_released_while_it_is_still_blocked(rig, running):
    session = running(effort_limit_nm=[10.0, 45.0, 45.0, 20.0, 20.0, 20.0])
    press(rig, session)
    assert session[CHANNEL].mode() is Mode.STOPPED and "joint_1" in EmergencyStop().reason()
    assert pull_nm(session) < 5.2
    EmergencyStop().release()
    session.clock.sleep(0.5)
    assert not EmergencyStop().latched and session[CHANNEL].mode() is Mode.HOLD
    assert pull_nm(session) < 1.0  # from the measured pose


LOW = [3.0, 6.0, 4.0, 2.0, 2.0, 2.0]  # shoulder and elbow need up to 17 and 10 Nm for the arm's own weight


def test_an_effort_limit_below_the_weight_lets_an_arm_move_and_land_and_stops_what_presses(rig, running):
    session = running(effort_limit_nm=LOW)
    for pose in ([0.8, 1.6, 1.0, 0.5, 0.0, 0.0], [-0.5, 0.6, 1.9, -0.5, 0.5, 0.5], [0.0, 2.0, 1.57, 0.0, 0.0, 0.0]):
        track(session, {CHANNEL: pose}, 1.2)
        assert not EmergencyStop().latched
    assert abs(session[CHANNEL].observe().tau_nm[1]) > 1.5 * LOW[1]  # of weight alone
    rig.push(CHANNEL, "link3", [0.0, 0.0, -60.0], 0.3)
    session.clock.sleep(0.3)
    assert session[CHANNEL].mode() is Mode.STOPPED
    assert "joint_2" in EmergencyStop().reason() and "beyond weight and motion" in EmergencyStop().reason()
    EmergencyStop().release()
    session[CHANNEL].land()
    session.clock.sleep(0.5)
    rig.push(CHANNEL, "link3", [0.0, 0.0, -60.0], 0.3)  # it is on its way down
    session.clock.sleep(0.4)
    assert not EmergencyStop().latched and session.stop()


def test_an_effort_limit_that_the_models_error_may_exceed_is_refused_before_anything_moves(rig, running):
    with pytest.raises(ConfigError, match=r"effort_limit_nm of joint_2 is 2 Nm, .* up to 1\d\.\d Nm, .* 3\.\d: give"):
        running(effort_limit_nm=[30.0, 2.0, 45.0, 20.0, 20.0, 20.0])
    assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())


def test_a_landing_that_was_obstructed_does_not_spring_when_the_way_is_freed(rig, running):
    session = running()
    track(session, {CHANNEL: NEAR}, 1.2)
    rig.fault(CHANNEL, "joint_2", "stuck")
    session[CHANNEL].land()
    session.clock.sleep(1.0)  # it presses for half a second before it gives way
    assert 80.0 * abs(np.subtract(session[CHANNEL].observe().setpoint_q, session[CHANNEL].observe().q)[1]) > 15.0
    recorders.watch_start(rig, CHANNEL)
    rig.fault(CHANNEL, "joint_2", "stuck", False)
    session.clock.sleep(6.0)
    assert fastest(rig) < 2.5  # else 3.5
    assert session[CHANNEL].mode() is Mode.OFF


@pytest.mark.long
@pytest.mark.parametrize(
    "gain", [{"kp": [60.0, 60.0, 60.0, 8.0, 8.0, 8.0]}, {"kd": [4.0, 4.0, 4.0, 1.0, 1.0, 1.0]}, {}]
)
def test_stiffer_gains_take_a_soft_arm_up_where_it_has_gone_to(rig, running, gain):
    session = running()
    track(session, {CHANNEL: NEAR}, 1.2)
    soft = {"kp": np.ones(6), "kd": np.ones(6)}
    track(session, {CHANNEL: NEAR}, 0.2, **soft)
    for way in np.linspace(0.0, 0.4, 40):  # a hand pushes it away
        rig.set_pose(CHANNEL, [NEAR[0] + way * (0.4 - NEAR[0]) / 0.4, *NEAR[1:]])
        track(session, {CHANNEL: NEAR}, 0.02, **soft)
    recorders.watch_start(rig, CHANNEL)
    for _ in range(30):
        session[CHANNEL].write_target(NEAR, 0.5, **gain)
        session.clock.sleep(1 / 30)
        assert Limited.CAME_FREE not in session[CHANNEL].observe().limited
    assert fastest(rig) < 1.95  # the limit is 1.5
    assert abs(session[CHANNEL].observe().q[0]) < 0.03


@pytest.mark.long
def test_gains_that_vary_do_not_shake_an_arm_that_carries_something(rig, running):
    session = running()
    track(session, {CHANNEL: NEAR}, 1.2)
    rig.push(CHANNEL, "link3", [0.0, 0.0, -40.0], 100.0)  # 4 kg that the model does not know
    track(session, {CHANNEL: NEAR}, 1.5, kp=np.full(6, 60.0))
    recorders.watch_start(rig, CHANNEL)
    for frame in range(60):
        session[CHANNEL].write_target(NEAR, 0.5, kp=np.full(6, 60.0 + 2.0 * (frame % 2)))
        session.clock.sleep(1 / 30)
    assert fastest(rig) < 0.15
