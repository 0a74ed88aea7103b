"""A request that arrives after its caller was told that it has failed is dropped, on a host in lock-step."""

import time

import pytest

from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.session.arm_client import REQUEST_TIMEOUT_S
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Request
from tests.support.hosted import ServedArms
from tests.support.link_in_step import LinkInStep
from tests.support.rigged import rig_of, sim_config

ARM = "follower_left"
POSE = [0.1, 0.2, 0.2, 0.0, 0.0, 0.1]
LATE_S = REQUEST_TIMEOUT_S + 0.2
AGE_S = 2.0  # which a state may have: what is asked after a stall needs none that is new


@pytest.fixture
def host():
    with rig_of("lockstep", arms=[ARM]) as rig, ServedArms(rig, ARM, max_state_age_s=AGE_S) as served:
        yield rig, served


@pytest.fixture
def session(host):
    rig, served = host
    device = HostedDevice(Host(served.address), "robot", ("",))
    config = sim_config(rig, ARM, max_state_age_s=AGE_S)
    session = ArmSession([config], LinkInStep.on(served, device))
    session.start()
    yield session
    session.stop()


def told(session, served):
    """Mode of the host's arm once it has the newest command, and has had the time to do what that says."""
    group, deadline = served.groups[0], time.monotonic() + 10.0
    before = group.newest
    while group.newest == before:
        assert time.monotonic() < deadline
        session._runner._link.turn()
    group._session.clock.sleep(0.1)
    return group._session[ARM].mode()


@pytest.mark.parametrize(
    ("age_s", "mode", "dropped"), [(0.9 * REQUEST_TIMEOUT_S, Mode.FLOAT, 0), (LATE_S, Mode.HOLD, 1)]
)
def test_it_is_carried_out_only_while_its_caller_waits(host, session, age_s, mode, dropped):
    _, served = host
    session[ARM].ask(Request.FLOAT)
    served.groups[0]._session.clock.sleep(age_s)  # a stall of the network, by the clock of the arms
    assert told(session, served) is mode
    assert served.groups[0].dropped == dropped


def test_a_target_does_not_bring_back_an_old_request(host, session):
    """The record of a new target has the last request in it, which the host has never seen."""
    _, served = host
    session[ARM].ask(Request.FLOAT)
    served.groups[0]._session.clock.sleep(LATE_S)
    session[ARM].write_target(POSE, 0.5)
    assert told(session, served) is Mode.TRACK
    assert served.groups[0].dropped == 1
