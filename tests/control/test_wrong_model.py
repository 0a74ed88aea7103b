"""An arm lands whatever its model says that it weighs: slowly, down to where cutting torque moves nothing."""

import math

import numpy as np
import pytest

from lerobot_robot_yam.control.landing.landing_move import LANDING_SPEED_RAD_S
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Request
from scripts import recorders
from tests.support.landed import MOST_M
from tests.support.rigged import lockstep_rig, session_on, sim_config, track

CHANNEL = "follower_left"
AT_MOST_S = 30.0
BRIEF = 5  # of 200 samples a second: a wrist that is let go knocks on the shoulder for some milliseconds
MID, HIGH, OUT, BACK = (
    [0, 1, 1, 0, 0, 0],
    [0, 1.2, 2.2, -0.8, 0, 0],
    [0.2, 1.9, 0.7, 0.9, 0.2, 0.3],
    [0, 0.3, 1.2, 1.2, 0.5, 0.5],
)
ABSENT, PRESENT = "configured and absent", "present and not configured"


rig = lockstep_rig(CHANNEL)


def land(rig, session, at_most_s=AT_MOST_S):
    """Returns how far any body moves after torque is cut, m, joint speeds on the way (ticks, 6), and the time, s."""
    speeds, held, begin = [], None, session.clock.now()
    session[CHANNEL].land()
    while session[CHANNEL].mode() is not Mode.OFF:
        assert session.clock.now() - begin < at_most_s, session[CHANNEL].published().message
        state = rig.state(bodies=True)
        held = {name: place for name, place in state["bodies"].items() if name.startswith(f"{CHANNEL}/")}
        speeds.append(np.abs(state["arms"][CHANNEL]["dq"]))
        session.clock.sleep(0.005)
    took_s = session.clock.now() - begin
    assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
    session.clock.sleep(1.5)
    after = rig.state(bodies=True)["bodies"]
    moved = max(float(np.linalg.norm(np.subtract(after[name], place))) for name, place in held.items())
    return moved, np.array(speeds), took_s


@pytest.mark.parametrize(
    "pose, fields, load_kg",
    [
        pytest.param(MID, {"payload_mass_kg": 1.0}, 0.0, id=f"1 kg {ABSENT}", marks=pytest.mark.long),
        pytest.param(HIGH, {"payload_mass_kg": 2.0}, 0.0, id=f"2 kg {ABSENT}", marks=pytest.mark.long),
        pytest.param(BACK, {"payload_mass_kg": 3.0}, 0.0, id=f"3 kg {ABSENT}", marks=pytest.mark.long),
        pytest.param(HIGH, {"gravity_factor": [1.5] * 6}, 0.0, id="factor 1.5"),
        pytest.param(BACK, {"gravity_factor": [2.0] * 6}, 0.0, id="factor 2", marks=pytest.mark.long),
        pytest.param(OUT, {"gravity_factor": [0.0] * 6}, 0.0, id="factor 0", marks=pytest.mark.long),
        pytest.param(OUT, {}, 2.0, id=f"2 kg {PRESENT}", marks=pytest.mark.long),
        pytest.param(
            OUT,
            {"payload_mass_kg": 3.0, "kp": [80, 80, 80, 40, 40, 40]},
            0.0,
            id="a stiff wrist",
            marks=pytest.mark.long,
        ),
    ],
)
def test_an_arm_lands_whose_model_is_wrong(rig, pose, fields, load_kg):
    session = session_on(rig, sim_config(rig, CHANNEL, **fields))
    session.start()
    try:
        track(session, {CHANNEL: pose}, 1.6)
        if load_kg:
            rig.push(CHANNEL, "gripper", [0.0, 0.0, -9.81 * load_kg], 100.0)
        session.clock.sleep(0.8)
        moved, speeds, _ = land(rig, session)
    finally:
        session.discard()
    assert moved <= MOST_M
    assert np.sort(speeds, axis=0)[-BRIEF].max() < 2 * LANDING_SPEED_RAD_S
    assert np.median(speeds.max(axis=1)) < LANDING_SPEED_RAD_S


def test_gains_that_are_given_while_an_arm_lands_are_refused(rig):
    """Soft ones would let it fall: its model carries less than it weighs."""
    session = session_on(rig, sim_config(rig, CHANNEL, gravity_factor=[0.8] * 6))
    session.start()
    try:
        track(session, {CHANNEL: OUT}, 1.6)
        session[CHANNEL].land()
        session.clock.sleep(0.2)
        recorders.watch_start(rig, CHANNEL)
        session[CHANNEL].ask(Request.GAINS, [*[1.0] * 6, math.nan, *[0.1] * 6, math.nan])
        session.clock.sleep(1.5)
        assert max(recorders.watch(rig, CHANNEL)["max_speed_rad_s"][:6]) < 2 * LANDING_SPEED_RAD_S
        assert "it lands with the configured gains" in session[CHANNEL].published().refusal
        assert session._runner._loop._controllers[0].actuation.impedance.own_gains
    finally:
        session.discard()


@pytest.mark.long
def test_an_arm_that_stays_obstructed_sinks_where_it_is(rig, caplog):
    """Today's fold, and the way round, are barred for ever: nobody waits for that with the arm in the air."""
    session = session_on(rig, sim_config(rig, CHANNEL))
    session.start()
    try:
        track(session, {CHANNEL: MID}, 1.5)
        rig.fault(CHANNEL, "joint_3", "stuck")
        moved, speeds, took_s = land(rig, session, 60.0)
    finally:
        session.discard()
    assert "it goes round" in caplog.text and "cannot land" in caplog.text and "it sinks slowly" in caplog.text
    assert took_s > 5.0  # it has tried
    assert moved <= MOST_M
    assert np.sort(speeds, axis=0)[-BRIEF].max() < 2 * LANDING_SPEED_RAD_S
