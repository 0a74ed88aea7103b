"""The emergency stop: latched for everything on this machine, released on purpose, no jump afterwards."""

import resource
import threading
import time

import numpy as np
import pytest

from lerobot_robot_yam.errors import EmergencyStopError, LifeCycleError, MotorError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session import runners
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.runners import StepRunner
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.support.rigged import either_rig, isolation_of, session_on, sim_config, track
from tests.support.tiers import spread

AWAY = [0.2, 1.0, 1.0, -0.3, 0.1, 0.1]


rig = either_rig("follower_left", "leader_left")


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


def end(session):
    """Land, on a live rig; a world in lock-step is thrown away: how an arm lands is not the matter here."""
    if isinstance(session._runner, StepRunner):
        session.discard()
    else:
        session.stop()


def wait_mode(session, name, mode, timeout_s=1.0):
    deadline = session.clock.now() + timeout_s
    while session[name].observe().mode is not mode:
        assert session.clock.now() < deadline, f"{session[name].observe().mode} instead of {mode}"
        session.clock.sleep(0.002)


def test_followers_hold_leaders_float_and_only_a_release_ends_it(rig, stop):
    session = session_on(rig, sim_config(rig, "follower_left"), sim_config(rig, "leader_left"))
    session.start()
    try:
        track(session, {"follower_left": AWAY}, 1.5)
        session["leader_left"].hold()
        session["follower_left"].write_target([-1.0, *AWAY[1:]], 0.5)  # on its way
        session.clock.sleep(0.1)
        stop.latch("a test")
        wait_mode(session, "follower_left", Mode.STOPPED)
        wait_mode(session, "leader_left", Mode.STOPPED)
        session.clock.sleep(0.6)  # it brakes within 50 ms and settles
        held = session["follower_left"].observe()
        assert Limited.EMERGENCY_STOP in held.limited
        asked, _ = session["follower_left"].write_target([1.0, *AWAY[1:]], 0.5)
        assert asked == pytest.approx(held.setpoint_q)  # what would be recorded is what is done
        session.clock.sleep(0.3)
        assert session["follower_left"].observe().q == pytest.approx(held.q, abs=2e-3)

        rig.push("leader_left", "link3", [0.0, 15.0, 0.0], 0.5)  # a floating arm gives way
        before = session["leader_left"].observe().q
        session.clock.sleep(0.6)
        assert np.abs(session["leader_left"].observe().q - before).max() > 0.05

        stop.release()
        wait_mode(session, "follower_left", Mode.HOLD)
        wait_mode(session, "leader_left", Mode.FLOAT)
        last = session["follower_left"].observe().setpoint_q
        assert last == pytest.approx(held.q, abs=5e-3)  # from the measured pose
        session["follower_left"].write_target(AWAY, 0.5)
        wait_mode(session, "follower_left", Mode.TRACK)
    finally:
        stop.release()
        end(session)


def test_a_leader_whose_peer_failed_meanwhile_holds_after_the_release(rig, stop):
    session = session_on(rig, sim_config(rig, "follower_left"), sim_config(rig, "leader_left"))
    session.start()
    try:
        wait_mode(session, "leader_left", Mode.FLOAT)
        stop.latch("a test")
        wait_mode(session, "leader_left", Mode.STOPPED)
        rig.fault("follower_left", "joint_2", "silent")
        session.clock.sleep(0.5)
        assert session["follower_left"].mode() is Mode.FAULT
        stop.release()
        wait_mode(session, "leader_left", Mode.HOLD)
        session.clock.sleep(0.2)
        assert session["leader_left"].mode() is Mode.HOLD
        rig.clear_faults("follower_left")
        for channel in ("follower_left", "leader_left"):
            session[channel].rearm()
        wait_mode(session, "leader_left", Mode.FLOAT)  # as it did before
    finally:
        rig.clear_faults("follower_left")
        stop.release()
        end(session)


def test_nothing_is_energised_while_it_is_latched(rig, stop):
    stop.latch("somebody shouted")
    session = session_on(rig, sim_config(rig, "follower_left"))
    with pytest.raises(EmergencyStopError, match=r"somebody shouted.*yam-estop release"):
        session.start()
    assert not any(m["enabled"] for m in rig.state()["arms"]["follower_left"]["motors"].values())
    stop.release()
    session.start()
    end(session)


@pytest.mark.parametrize(("outlives_us", "said"), [(True, "the arms stay in the air"), (False, "THIS PROCESS HOLDS")])
def test_a_landing_is_waited_for_only_where_it_ends_with_this_process(stop, caplog, monkeypatch, outlives_us, said):
    monkeypatch.setattr(runners, "_STOPPED_S", 0.0)
    stop.latch("a test")
    until_s = time.monotonic() + 0.3
    down = runners.wait_patiently(lambda: time.monotonic() > until_s, outlives_us)
    assert down is not outlives_us and caplog.text.count(said) == 1


@pytest.mark.long
def test_who_ends_a_session_is_told_what_lands_the_arms_and_nobody_is_told_to_end_what_holds_them(stop, caplog):
    with running_rig(arms=["follower_left"]) as live:

        def enabled():
            return any(motor["enabled"] for motor in live.state()["arms"]["follower_left"]["motors"].values())

        session = session_on(live, sim_config(live, "follower_left"))
        session.start()
        stop.latch("a test")
        begin = time.monotonic()
        session.stop()
        assert time.monotonic() - begin < 10.0 and enabled()
        assert "the arms stay in the air" in caplog.text
        with pytest.raises(EmergencyStopError, match="a test.*yam-estop release"):
            session_on(live, sim_config(live, "follower_left")).start()
        assert enabled()
        stop.release()
        deadline = time.monotonic() + 20.0
        while enabled():
            assert time.monotonic() < deadline, "not landed"
            time.sleep(0.1)


@pytest.mark.long
def test_a_loop_in_a_thread_is_waited_for_since_it_ends_with_its_process(stop, caplog):
    with running_rig(arms=["follower_left"]) as live:
        session = ArmSession([sim_config(live, "follower_left")], isolation="thread")
        session.start()
        stop.latch("a test")
        ending = threading.Thread(target=session.stop)
        ending.start()
        ending.join(4.0)
        assert ending.is_alive() and "THIS PROCESS HOLDS THE ARMS" in caplog.text
        stop.release()
        ending.join(20.0)
        assert not ending.is_alive()
        assert not any(m["enabled"] for m in live.state()["arms"]["follower_left"]["motors"].values())


def test_a_stop_while_the_arms_come_up_ends_the_start_and_they_land_when_it_is_released(stop):
    with running_rig(arms=["follower_left"]) as live:
        session = session_on(live, sim_config(live, "follower_left", gripper_stops_rad=None))  # to be sought: seconds
        raised = []

        def begin():
            try:
                session.start()
            except MotorError as error:
                raised.append(str(error))

        def on():
            return [m["enabled"] for m in live.state()["arms"]["follower_left"]["motors"].values()]

        starting = threading.Thread(target=begin)
        starting.start()
        while not all(on()):
            time.sleep(0.01)
        time.sleep(0.3)
        stop.latch("a test")
        time.sleep(0.5)
        assert starting.is_alive() and all(on())  # held
        stop.release()
        starting.join(20.0)
        assert len(raised) == 1 and "latched while the arms came up" in raised[0]
        assert not any(on())


def test_it_is_latched_without_a_descriptor_left(stop):
    """A program may have all that it can have: connections, for one."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        stop.latch("a test")
        assert EmergencyStop().latched
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert "unknown" in EmergencyStop().reason()
    EmergencyStop().release()
    assert not EmergencyStop().latched


@pytest.mark.parametrize("begin", spread(["asked to land", "the session ends"], 0))
def test_a_landing_is_interrupted_and_goes_on_after_the_release(rig, stop, begin):
    session = session_on(rig, sim_config(rig, "follower_left"))
    session.start()
    clock = session.clock
    track(session, {"follower_left": AWAY}, 2.0)
    ending = threading.Thread(target=session.stop)
    if begin == "asked to land":
        session["follower_left"].land()
    elif isolation_of(rig) == "lockstep":
        session._runner._landing = True  # what `stop` does first; its time would pass nowhere else
    else:
        ending.start()
    clock.sleep(0.5)
    stop.latch("a hand in the way")
    clock.sleep(0.6)
    held = rig.state()["arms"]["follower_left"]
    assert all(m["enabled"] for m in held["motors"].values()) and held["q"][1] > 0.3
    clock.sleep(0.5)
    assert rig.state()["arms"]["follower_left"]["q"] == pytest.approx(held["q"], abs=5e-3)
    stop.release()
    if ending.ident is None:
        session.stop()
    else:
        ending.join(20)
        assert not ending.is_alive()
    assert not any(m["enabled"] for m in rig.state()["arms"]["follower_left"]["motors"].values())


def test_a_target_between_the_stop_and_the_next_tick_moves_nothing(rig, stop):
    session = session_on(rig, sim_config(rig, "follower_left"))
    session.start()
    try:
        track(session, {"follower_left": AWAY}, 1.5)
        session["follower_left"].hold()
        session.clock.sleep(0.3)
        before = session["follower_left"].observe().q
        stop.latch("a test")
        session["follower_left"].write_target([-1.0, *AWAY[1:]], 0.5)
        session.clock.sleep(0.3)
        assert session["follower_left"].observe().q == pytest.approx(before, abs=5e-3)
        stop.release()
        wait_mode(session, "follower_left", Mode.HOLD)
        session.clock.sleep(0.3)
        assert session["follower_left"].observe().q == pytest.approx(before, abs=5e-3)
    finally:
        stop.release()
        end(session)


def test_what_is_asked_in_the_tick_of_a_stop_or_a_release_is_answered_by_it(rig, stop):
    name = "follower_left"
    session = session_on(rig, sim_config(rig, name))
    session.start()
    try:
        rig.fault(name, "joint_1", "nibble", 0xE)
        session.clock.sleep(0.1)
        assert session[name].mode() is Mode.FAULT
        stop.latch("a test")
        with pytest.raises(LifeCycleError, match="emergency stop is latched"):
            session[name].rearm()
        assert not rig.state()["arms"][name]["motors"]["joint_1"]["enabled"]
        session.clock.sleep(0.1)
        stop.release()
        session[name].rearm()
        session.clock.sleep(0.1)
        assert session[name].mode() is Mode.HOLD
    finally:
        stop.release()
        end(session)


def test_a_button_of_the_handle_latches_it(rig, stop):
    session = session_on(rig, sim_config(rig, "leader_left", estop_button="bottom"))
    session.start()
    try:
        rig.buttons("leader_left", sync=True)
        session.clock.sleep(0.2)
        assert not stop.latched  # the other one
        rig.buttons("leader_left", record=True)
        wait_mode(session, "leader_left", Mode.STOPPED)
        assert "leader_left" in stop.reason()
        stop.release("leader_left")
        rig.buttons("leader_left")
        wait_mode(session, "leader_left", Mode.FLOAT)
        stop.latch("of a workstation", "workstation:5f")
        wait_mode(session, "leader_left", Mode.STOPPED)
        rig.buttons("leader_left", record=True)  # somebody at the arms stops them, too
        session.clock.sleep(0.1)
        stop.release("workstation:5f")
        session.clock.sleep(0.1)
        assert session["leader_left"].mode() is Mode.STOPPED and stop.names() == ["leader_left"]
    finally:
        stop.release()
        end(session)


@pytest.mark.long
def test_a_stop_in_mid_landing_throws_no_joint_that_is_not_heard(rig, stop):
    """It obeys, and is far from where it was heard last."""
    session = session_on(rig, sim_config(rig, "follower_left"))
    session.start()
    try:
        track(session, {"follower_left": AWAY}, 1.5)
        rig.fault("follower_left", "joint_2", "loss_rate", 1.0)
        session.clock.sleep(0.6)
        session["follower_left"].land()
        session.clock.sleep(1.2)
        stop.latch("a test")
        session.clock.sleep(0.02)
        recorders.watch_start(rig, "follower_left")
        session.clock.sleep(0.5)
        assert recorders.watch(rig, "follower_left")["max_speed_rad_s"][1] < 0.6
        rig.fault("follower_left", "joint_2", "loss_rate", 0.0)
    finally:
        stop.release()
        end(session)
