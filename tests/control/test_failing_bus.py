"""A python-can back end that fails in a way nobody knows: the bus is lost, and a loop without a caller ends."""

import logging
import struct

import pytest

from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepBus
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from tests.support.rigged import lockstep_rig, running_arm, session_on, sim_config, track

CHANNEL, PEER = "follower_left", "follower_right"
POSE = [0.0, 1.0, 1.2, 0.0, 0.0, 0.0]
ENDS_S = 1.5  # of which the motors' watchdogs take 0.4

rig = lockstep_rig(CHANNEL, PEER)
session = running_arm(CHANNEL)


class Backend:
    """What the channel's bus raises in place of its work, or returns in place of a frame; None: it works."""

    def __init__(self, monkeypatch):
        self.raises = self.returns = None
        for name in ("send_many", "recv"):
            monkeypatch.setattr(LockstepBus, name, self._instead(getattr(LockstepBus, name)))

    def _instead(self, work):
        def fail(bus, *arguments):
            if self.raises is not None and bus.channel_info.startswith(f"yam_lockstep channel {CHANNEL} "):
                raise self.raises
            return work(bus, *arguments) if self.returns is None else self.returns

        return fail


@pytest.fixture
def backend(monkeypatch):
    return Backend(monkeypatch)


def until_ended_s(rig, session):
    """Time that the loop takes to end once its caller wants that."""
    begin = rig.now()
    assert session.stop()
    return rig.now() - begin


@pytest.mark.parametrize(
    "error", [struct.error("unpack requires 8 bytes"), ValueError("not a hex digit"), RuntimeError("USBError 19")]
)
def test_whatever_a_back_end_raises_is_a_lost_bus(backend, rig, session, caplog, error):
    track(session, {CHANNEL: POSE}, 0.5)
    backend.raises = error
    session.clock.sleep(0.02)
    assert session[CHANNEL].mode() is Mode.FAULT and session[CHANNEL].published().trouble == Trouble.ADAPTER_GONE
    with pytest.raises(MotorError, match=f"{CHANNEL}: (send|receive) failed .{type(error).__name__}.*plugged"):
        session[CHANNEL].observe()
    session.clock.sleep(0.5)
    assert until_ended_s(rig, session) < ENDS_S
    assert not [record for record in caplog.records if record.exc_info]
    assert "cannot be landed: CAN channel" in caplog.text


def test_the_other_arm_holds_and_lands(backend, rig):
    session = session_on(rig, sim_config(rig, CHANNEL), sim_config(rig, PEER))
    session.start()
    backend.raises = struct.error("unpack requires 8 bytes")
    session.clock.sleep(0.1)
    assert session[PEER].mode() is Mode.HOLD
    assert session.stop()
    assert not any(motor["enabled"] for motor in rig.state()["arms"][PEER]["motors"].values())


@pytest.mark.parametrize("stopped", [False, True])
def test_a_defect_at_each_tick_keeps_no_loop_alive_whose_bus_is_dead(backend, rig, session, caplog, stopped):
    """Also where an emergency stop is latched, which would delay the landing of an arm that can be reached."""
    track(session, {CHANNEL: POSE}, 0.5)
    backend.returns = object()  # no frame: whoever reads it fails
    session.clock.sleep(0.5)
    assert session[CHANNEL].published().trouble == Trouble.INTERNAL_ERROR
    if stopped:
        EmergencyStop().latch("a test")
    try:
        assert until_ended_s(rig, session) < ENDS_S
    finally:
        EmergencyStop().release()
    traces = [record.levelno for record in caplog.records if record.exc_info]
    assert traces == [logging.CRITICAL]
