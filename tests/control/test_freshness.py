"""No caller acts on an old state: who looks, and who gives a target, is told that it is old."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.errors import MotorError, StaleStateError
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.support.rigged import STOPS, lockstep_rig, session_on, sim_config

CHANNEL = "follower_left"
MAX_AGE_S = 0.03
POSE = np.array([0.1, 0.5, 0.5, 0.0, 0.0, 0.0])

rig = lockstep_rig(CHANNEL)


@pytest.fixture
def session(rig):
    session = session_on(rig, sim_config(rig, CHANNEL, max_state_age_s=MAX_AGE_S))
    session.start()
    yield session
    session.discard()


CALLS = {
    "observe": lambda port: port.observe(),
    "track": lambda port: port.write_target(POSE, 0.5),
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("motor", ["joint_4", None])
def test_a_state_that_is_too_old_is_refused_until_a_new_one_has_come(rig, session, call, motor):
    """Long before a silent motor is a fault."""
    CALLS[call](session[CHANNEL])
    rig.fault(CHANNEL, motor, "silent")
    begin, refused_s = session.clock.now(), None
    while session.clock.now() < begin + 0.08:
        session.clock.sleep(0.002)
        with contextlib.suppress(StaleStateError):
            CALLS[call](session[CHANNEL])
            assert refused_s is None, "it was too old, and is older now"
            continue
        refused_s = refused_s or session.clock.now() - begin
    assert refused_s is not None and MAX_AGE_S - 0.008 < refused_s < MAX_AGE_S + 0.008
    rig.fault(CHANNEL, motor, "silent", False)
    session.clock.sleep(0.3)  # for so long its answers may be late ones to earlier questions
    CALLS[call](session[CHANNEL])


def test_who_is_refused_is_told_which_arm_and_how_old(rig, session):
    rig.fault(CHANNEL, None, "drop_next", 15)
    session.clock.sleep(0.05)
    with pytest.raises(StaleStateError, match=rf"{CHANNEL} \({CHANNEL}\): newest state is 0\.0\d s old"):
        session[CHANNEL].observe()


def test_an_arm_that_is_heard_again_does_not_rush_after_its_set_point(rig):
    session = session_on(rig, sim_config(rig, CHANNEL))
    session.start()
    port = session[CHANNEL]
    told, silent, begin = Limited.NOTHING, False, session.clock.now()
    recorders.truth_start(rig, CHANNEL)
    while (passed_s := session.clock.now() - begin) < 1.5:
        if silent is not (silent := 1.06 < passed_s < 1.14):
            rig.fault(CHANNEL, None, "loss_rate", float(silent))
        with contextlib.suppress(MotorError):
            port.write_target(POSE, 0.5 if passed_s < 1.0 else 0.95)
        session.clock.sleep(0.004)
        told |= port.published().limited
    session.discard()
    assert Limited.UNHEARD in told
    speed = np.abs(recorders.truth(rig, CHANNEL)["dq"])
    assert speed[:, 6].max() < 1.3 * port.hardware.speed_limit[6] * abs(STOPS[1] - STOPS[0])
