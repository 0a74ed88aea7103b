"""Two arms of one session: what stops one stops both, and both wait for a caller that has fallen silent."""

import logging

import pytest

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.face.operator_keys.auto_episodes import led_by_hand
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.control.test_fault_matrix import AWAY, LEFT, RIGHT, SLACK_S, wait_for
from tests.support.rigged import either_rig, isolation_of, leave, session_on, sim_config, track

rig = either_rig(LEFT, RIGHT)


def test_a_stale_caller_leaves_the_arm_holding_and_the_next_target_moves_it(rig, caplog, capfd):
    caplog.set_level(logging.INFO)
    session = session_on(rig, sim_config(rig, LEFT), sim_config(rig, RIGHT))
    session.start()
    try:
        track(session, {LEFT: AWAY, RIGHT: AWAY}, 0.5)
        session.clock.sleep(0.8)
        for channel in (LEFT, RIGHT):
            state = session[channel].observe()
            assert state.mode is Mode.HOLD and Limited.COMMAND_TIMEOUT in state.limited
        track(session, {LEFT: AWAY, RIGHT: AWAY}, 0.2)
        assert session[LEFT].observe().mode is Mode.TRACK
    finally:
        leave(rig, session)
    assert f"{LEFT}: no target for 0.5 s; it holds" in caplog.text + capfd.readouterr().err


def test_too_much_effort_latches_the_emergency_stop(rig):
    session = session_on(
        rig,
        sim_config(rig, LEFT, effort_limit_nm=[10.0, 45.0, 45.0, 20.0, 20.0, 20.0]),
        sim_config(rig, RIGHT),
    )
    session.start()
    clock = session.clock
    try:
        track(session, {LEFT: AWAY, RIGHT: AWAY}, 1.3)
        rig.push(LEFT, "link4", [0.0, 60.0, 0.0], 1.0)
        wait_for(clock, "latched", lambda: EmergencyStop().latched, 1.0)
        assert "joint_1" in EmergencyStop().reason()
        wait_for(
            clock,
            "both stop",
            lambda: {session[c].mode() for c in (LEFT, RIGHT)} == {Mode.STOPPED},
            SLACK_S[isolation_of(rig)],
        )
        clock.sleep(1.5)  # nobody pushes any more
    finally:
        EmergencyStop().release()
        leave(rig, session)


@pytest.mark.long
def test_an_arm_that_holds_because_of_the_other_is_released_with_it_and_not_before(rig):
    session = session_on(rig, sim_config(rig, LEFT), sim_config(rig, RIGHT))
    session.start()
    try:
        rig.fault(RIGHT, "joint_6", "nibble", int(Fault.OVERLOAD), sticky=True)
        wait_for(session.clock, "it is noticed", lambda: session[RIGHT].mode() is Mode.FAULT, 1.0)
        with pytest.raises(LifeCycleError, match="cannot re-arm.*joint_6"):
            session.rearm()
        track(session, {LEFT: AWAY}, 0.2)
        assert session[LEFT].mode() is Mode.HOLD  # it takes no targets
        rig.clear_faults(RIGHT)
        session.rearm()
        track(session, {LEFT: AWAY, RIGHT: AWAY}, 0.2)
        assert {session[channel].mode() for channel in (LEFT, RIGHT)} == {Mode.TRACK}
    finally:
        leave(rig, session)


def test_an_arm_that_holds_because_of_the_other_is_not_released_alone(rig):
    session = session_on(rig, sim_config(rig, LEFT), sim_config(rig, RIGHT))
    session.start()
    try:
        rig.fault(RIGHT, "joint_6", "nibble", int(Fault.OVERLOAD), sticky=True)
        wait_for(session.clock, "it is noticed", lambda: session[RIGHT].mode() is Mode.FAULT, 1.0)
        with pytest.raises(LifeCycleError, match=f"{LEFT}: holds as long as {RIGHT} is in trouble: overload"):
            session[LEFT].rearm()
        track(session, {LEFT: AWAY}, 0.2)
        assert session[LEFT].mode() is Mode.HOLD
        rig.clear_faults(RIGHT)
        session[RIGHT].rearm()
        session[LEFT].rearm()
        track(session, {LEFT: AWAY, RIGHT: AWAY}, 0.2)
        assert {session[channel].mode() for channel in (LEFT, RIGHT)} == {Mode.TRACK}
    finally:
        leave(rig, session)


def test_of_two_arms_in_trouble_the_one_re_armed_first_waits_for_the_other(rig):
    session = session_on(rig, sim_config(rig, LEFT), sim_config(rig, RIGHT))
    session.start()
    try:
        for channel in (LEFT, RIGHT):
            rig.fault(channel, "joint_6", "nibble", int(Fault.OVERLOAD), sticky=channel == RIGHT)
        both = {LEFT, RIGHT}
        wait_for(session.clock, "it is noticed", lambda: {session[c].mode() for c in both} == {Mode.FAULT}, 1.0)
        with pytest.raises(LifeCycleError, match="cannot re-arm.*joint_6"):
            session.rearm()
        track(session, {LEFT: AWAY}, 0.2)
        assert session[LEFT].mode() is Mode.HOLD
        halted = session[LEFT].published()
        assert Limited.PEER in halted.limited and not led_by_hand([halted])
        rig.clear_faults(RIGHT)
        rig.fault(LEFT, "joint_5", "nibble", int(Fault.OVERLOAD))
        wait_for(session.clock, "it is noticed", lambda: session[LEFT].mode() is Mode.FAULT, 1.0)
        session.rearm()
        track(session, {LEFT: AWAY, RIGHT: AWAY}, 0.2)
        assert {session[channel].mode() for channel in both} == {Mode.TRACK}
    finally:
        leave(rig, session)


class Ticks:
    """What a stand-by sees of a loop: how long an arm's published tick stays the same."""

    def __init__(self, session, channel):
        self._clock, self._port = session.clock, session[channel]
        self._tick, self._since_s, self.longest_s = self._port.published().tick, self._clock.now(), 0.0

    def look(self):
        tick, now = self._port.published().tick, self._clock.now()
        self.longest_s = max(self.longest_s, now - self._since_s)
        if tick != self._tick:
            self._tick, self._since_s = tick, now


@pytest.mark.long
@pytest.mark.parametrize("latency_s", [0.0, 0.04])
def test_an_arm_that_switches_off_on_a_bad_wire_keeps_the_other_one_waiting_for_no_long(rig, latency_s):
    """A stand-by takes a loop for hung that has not ticked for 0.14 s, and motors let go after 0.4 s without commands.

    The arm that has landed takes several ticks until all its motors have said that they are off.
    """
    session = session_on(rig, sim_config(rig, LEFT), sim_config(rig, RIGHT))
    session.start()
    try:
        track(session, {LEFT: AWAY, RIGHT: AWAY}, 1.5)
        rig.fault(LEFT, None, "latency_s", latency_s)
        for kind in ("loss_rate", "command_loss_rate"):
            rig.fault(LEFT, None, kind, 0.2)
        recorders.watch_start(rig, RIGHT)
        ticks = Ticks(session, RIGHT)
        session[LEFT].land()
        deadline = session.clock.now() + 20.0
        while session[LEFT].mode() is not Mode.OFF:
            assert session.clock.now() < deadline
            session.clock.sleep(0.004)
            ticks.look()
        assert not any(motor["enabled"] for motor in rig.state()["arms"][LEFT]["motors"].values())
        most_s = 0.01 if isolation_of(rig) == "lockstep" else 0.08
        assert ticks.longest_s < most_s
        assert max(recorders.watch(rig, RIGHT)["max_command_age_s"]) < most_s
    finally:
        rig.clear_faults(LEFT)
        leave(rig, session)
