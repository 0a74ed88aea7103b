"""A gripper's stops, searched and stored by a session."""

import contextlib
import json
import time

import pytest

from lerobot_robot_yam.errors import GripperError, LifeCycleError, MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Request
from scripts import recorders
from tests.support.rigged import STOPS, arm_on, rig_of, session_on, sim_config, track
from tests.support.tiers import spread

LEFT, RIGHT = "follower_left", "follower_right"
AWAY = [0.2, 1.0, 1.0, -0.3, 0.1, 0.1]


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig(arms=[LEFT, RIGHT])) as rig:
        yield rig


@pytest.fixture
def session(rig):
    session = session_on(rig, sim_config(rig, LEFT), sim_config(rig, RIGHT))
    session.start()
    yield session
    session.discard()


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


def wait_for(path):
    """What was found is stored beside the loop."""
    deadline = time.monotonic() + 5.0
    while not path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_calibration_finds_and_keeps_the_stops(tmp_path):
    path = tmp_path / "left_gripper.json"
    with rig_of("lockstep", arms=[LEFT]) as rig:
        with arm_on(rig, LEFT, gripper_stops_rad=None, calibration_path=str(path)):
            wait_for(path)
        first = path.read_text()
        with arm_on(rig, LEFT, gripper_stops_rad=None, calibration_path=str(path)) as arm:  # they are verified only
            assert arm.observe().gripper == pytest.approx(1.0, abs=0.15)
    assert path.read_text() == first


def test_a_calibration_that_stores_nothing_has_failed_and_the_arm_is_held(tmp_path):
    blocked = tmp_path / "left"
    with contextlib.closing(LockstepRig(arms=["follower_left"])) as rig:
        config = sim_config(
            rig, "follower_left", interface="yam_lockstep", gripper_stops_rad=None, calibration_path=f"{blocked}/g.json"
        )
        session = ArmSession([config], isolation="lockstep")
        session.start(search_grippers=False)
        port = session["follower_left"]
        blocked.touch()  # a file where a directory has to be
        with pytest.raises(GripperError, match="follower_left: .*left/g.json cannot be read"):
            port.calibrate_gripper()
        blocked.unlink()
        port.calibrate_gripper()
        blocked.rename(tmp_path / "lost")
        blocked.symlink_to("/proc")  # where nobody can store anything
        with pytest.raises(GripperError, match="follower_left: nothing was stored in .*left/g.json; the log"):
            port.calibrate_gripper()
        assert port.observe().mode is Mode.HOLD
        session.discard()


def test_a_calibration_is_refused_while_stopped_and_the_grip_is_kept(session, stop):
    port = session[LEFT]
    track(session, {LEFT: AWAY}, 1.0, gripper=0.4)
    stop.latch("a test")
    session.clock.sleep(0.1)
    before = port.observe().gripper
    with pytest.raises(LifeCycleError, match="yam-estop release"):
        port.calibrate_gripper()
    session.clock.sleep(0.3)
    assert port.observe().mode is Mode.STOPPED and port.observe().gripper == pytest.approx(before, abs=0.01)


def test_a_calibration_that_is_stopped_has_failed(session, stop):
    port = session[LEFT]
    controller = session._runner._loop._controllers[0]
    advance = controller.actuation.gripper.advance

    begin_s = session.clock.now()

    def stopped_after_a_second(now, motor_rad):
        if now - begin_s > 1.0:
            stop.latch("a test")
        return advance(now, motor_rad)

    controller.actuation.gripper.advance = stopped_after_a_second
    with pytest.raises(MotorError, match="was cut short .stopped"):
        port.calibrate_gripper()


def test_a_search_that_fails_leaves_the_fingers_still_and_has_the_peer_hold(rig, session):
    track(session, {LEFT: AWAY, RIGHT: AWAY}, 1.0)
    rig.fault(LEFT, "gripper", "stuck")
    with pytest.raises(MotorError, match="gripper does not move"):
        session[LEFT].calibrate_gripper()
    session.clock.sleep(0.1)
    recorders.watch_start(rig, LEFT)
    track(session, {RIGHT: [-0.2, *AWAY[1:]]}, 1.0)
    assert recorders.watch(rig, LEFT)["max_torque_nm"][-1] < 0.1
    assert session[RIGHT].observe().mode is Mode.HOLD  # and takes no targets
    assert session[RIGHT].observe().q[0] == pytest.approx(AWAY[0], abs=0.02)


def test_stops_that_are_being_searched_are_not_published(session):
    session[LEFT]._request(Request.CALIBRATE_GRIPPER)
    session.clock.sleep(0.1)
    assert session[LEFT].mode() is Mode.BRING_UP
    assert session[LEFT].published().gripper_stops_rad is None
    with pytest.raises(GripperError, match="being sought"):
        session[LEFT].observe()


def test_where_fingers_with_unknown_stops_are_is_not_said_during_an_emergency_stop_either(rig, session, stop):
    port = session[LEFT]
    port._request(Request.CALIBRATE_GRIPPER)
    session.clock.sleep(0.5)
    stop.latch("a test")
    session.clock.sleep(0.1)
    assert port.mode() is Mode.STOPPED
    with pytest.raises(GripperError, match="yam-estop release"):
        port.observe()
    stop.release()
    session.clock.sleep(0.1)
    port.await_gripper()
    assert port.observe().gripper == pytest.approx(rig.state()["arms"][LEFT]["opening"], abs=0.02)


@pytest.mark.parametrize("how", spread(["hold", "float"], 1))
def test_holding_or_floating_waits_for_the_end_of_a_search(session, how):
    port = session[LEFT]
    port._request(Request.CALIBRATE_GRIPPER)
    session.clock.sleep(0.1)
    getattr(port, how)()
    assert port.mode() is Mode.BRING_UP
    port.await_gripper()
    session.clock.sleep(0.1)
    assert port.observe().mode is (Mode.HOLD if how == "hold" else Mode.FLOAT)  # and its stops are known


@pytest.mark.parametrize(
    ("stops", "stuck", "known"),
    [
        (None, False, False),  # nothing is known, and nothing is sought
        (STOPS, False, True),
        (STOPS, True, False),  # two turns fit, and the fingers do not show which
        ([3.25, 3.0], False, False),  # cannot be the ends
    ],
)
def test_who_may_calibrate_afterwards_starts_with_what_is_known_and_fits(rig, tmp_path, caplog, stops, stuck, known):
    path = tmp_path / "left_gripper.json"
    if stops is not None:
        data = {"version": 1, "gripper": "linear_4310", "closed_rad": stops[0], "open_rad": stops[1]}
        path.write_text(json.dumps(data))
    if stuck:
        rig.fault(LEFT, "gripper", "stuck")
    session = session_on(rig, sim_config(rig, LEFT, gripper_stops_rad=None, calibration_path=str(path)))
    session.start(search_grippers=False)
    try:
        port = session[LEFT]
        if known:
            assert port.observe().gripper is not None
        else:
            with pytest.raises(GripperError, match="stops are unknown"):
                port.observe()
            assert ("unknown until then" in caplog.text) == (stops is not None)
        assert port.mode() is Mode.HOLD
        rig.clear_faults(LEFT)
        port.calibrate_gripper()
        assert port.observe().gripper is not None
    finally:
        session.discard()
