"""A state says when it was true, however long its adapter takes, and however long that keeps frames back."""

import numpy as np
import pytest

from lerobot_robot_yam.damiao.tables import MOTOR_TYPES
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.state.modes import Mode
from scripts import recorders
from tests.support.rigged import rig_of, session_on, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
MIDDLE = np.array([0.0, 1.2, 1.2, 0.0, 0.0, 0.0])
SWING_RAD, SWING_HZ = 0.5, 0.45  # 1.4 rad/s at most
QUANTUM_RAD = 2 * MOTOR_TYPES["DM4310"].position_max_rad / 65535
MOST_RAD = QUANTUM_RAD + 0.002


def swing(session, seconds):
    """All joints move to and fro; yields the state of each tick."""
    clock = session.clock
    begin = next_target_s = clock.now()
    while clock.now() < begin + seconds:
        if clock.now() >= next_target_s:
            next_target_s += 1 / 30
            session[CHANNEL].write_target(
                MIDDLE + SWING_RAD * np.sin(2 * np.pi * SWING_HZ * (clock.now() - begin)), 0.5
            )
        clock.sleep(0.004)
        yield session[CHANNEL].published()


def check_against_truth(rig, session, seconds=2.5):
    """Largest age of a state, s, from the command that it answers."""
    recorders.truth_start(rig, CHANNEL)
    seen = [(session.clock.now(), state) for state in swing(session, seconds)]
    truth = recorders.truth(rig, CHANNEL)
    assert np.abs(truth["dq"][:, :6]).max(axis=0).min() > 1.2, "it is meant to move"
    for now, state in seen:
        stamps = state.motor_stamps_s[:6]
        assert (stamps >= state.asked_s).all() and (stamps < now).all()
        if stamps.min() < truth["stamp_s"][0]:
            continue
        true = [np.interp(state.stamp_s, truth["stamp_s"], truth["q"][:, i]) for i in range(6)]
        assert np.abs(state.q - true).max() <= MOST_RAD and state.q_error_rad <= 0.002
    assert seen[-1][1].mode is Mode.TRACK
    return max(now - state.asked_s for now, state in seen)


@pytest.mark.parametrize("latency_ms", spread([0, 1, 5, 20, 40], 2))
def test_an_adapter_that_takes_its_time(latency_ms, caplog):
    with rig_of("lockstep", arms=[CHANNEL], latency_s=latency_ms / 1e3) as rig:
        session = session_on(rig, sim_config(rig, CHANNEL))
        session.start()
        track(session, {CHANNEL: MIDDLE}, 1.5)
        oldest_s = check_against_truth(rig, session)
        session.stop()
    assert oldest_s == pytest.approx(2 * latency_ms / 1e3 + 0.004, abs=0.0055)
    assert (f"took up to {latency_ms} ms each way" in caplog.text) == (latency_ms > 2)


@pytest.mark.long
def test_an_adapter_that_becomes_slow():
    with rig_of("lockstep", arms=[CHANNEL]) as rig:
        session = session_on(rig, sim_config(rig, CHANNEL))
        session.start()
        track(session, {CHANNEL: MIDDLE}, 1.5)
        rig.fault(CHANNEL, None, "latency_s", 0.02)
        list(swing(session, 0.5))  # of a step no half can be attributed to either way at first
        check_against_truth(rig, session)
        session.discard()


@pytest.mark.long
@pytest.mark.parametrize("latency_s", [0.005, 0.02])
def test_an_adapter_that_becomes_quick_makes_nobody_distrust_a_fast_gripper(latency_s):
    with rig_of("lockstep", arms=[CHANNEL], latency_s=latency_s) as rig:
        session = session_on(rig, sim_config(rig, CHANNEL, gripper_force_limit_n=None))
        session.start()
        for opening in (1.0, 0.0, 1.0, 0.0):
            rig.fault(CHANNEL, None, "latency_s", latency_s)
            track(session, {CHANNEL: MIDDLE}, 1.0, gripper=opening)
            session[CHANNEL].write_target(MIDDLE, 1.0 - opening)
            session.clock.sleep(0.15)
            assert abs(session[CHANNEL].published().gripper_rate) > 1.0, "it is meant to move"
            rig.fault(CHANNEL, None, "latency_s", 0.0)
            track(session, {CHANNEL: MIDDLE}, 0.5, gripper=1.0 - opening)
            assert session[CHANNEL].published().trouble is None
        session.discard()


@pytest.mark.long
@pytest.mark.parametrize(
    "hold",
    [{"seconds": 0.03, "every_s": 0.2}, {"seconds": 0.08, "every_s": 0.25}, {"seconds": 0.016, "every_s": 0.017}],
)
def test_an_adapter_that_keeps_frames_back(hold, caplog):
    with rig_of("lockstep", arms=[CHANNEL]) as rig:
        session = session_on(rig, sim_config(rig, CHANNEL))
        session.start()
        track(session, {CHANNEL: MIDDLE}, 1.5)
        rig.fault(CHANNEL, None, "hold_back", hold)
        oldest_s = check_against_truth(rig, session)
        rig.clear_faults(CHANNEL)
        session.stop()
    assert oldest_s == pytest.approx(hold["seconds"] + 0.004, abs=0.006)
    assert ("an answer took up to" in caplog.text) == (hold["seconds"] > 0.02)


def test_states_that_are_older_than_the_limit_are_refused():
    with rig_of("lockstep", arms=[CHANNEL]) as rig:
        session = session_on(rig, sim_config(rig, CHANNEL, max_state_age_s=0.03))
        session.start()
        session[CHANNEL].observe()
        rig.fault(CHANNEL, None, "latency_s", 0.02)
        session.clock.sleep(0.3)
        with pytest.raises(StaleStateError, match="or the CAN adapter is that slow"):
            session[CHANNEL].observe()
        session.discard()


@pytest.mark.parametrize(("kind", "value", "seconds"), [("cable_out", True, 0.3), ("loss_rate", 0.05, 3.0)])
def test_lost_replies_are_not_held_against_the_adapter(kind, value, seconds, caplog):
    with rig_of("lockstep", arms=[CHANNEL]) as rig:
        session = session_on(rig, sim_config(rig, CHANNEL))
        session.start()
        track(session, {CHANNEL: MIDDLE}, 1.0)
        rig.fault(CHANNEL, None, kind, value)
        session.clock.sleep(seconds)
        rig.clear_faults(CHANNEL)
        session.clock.sleep(1.5)
        session.discard()
    assert "the CAN adapter" not in caplog.text and "answers were lost; check cable, plugs" in caplog.text
