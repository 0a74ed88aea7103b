"""A host in lock-step: clients hear when it lets go of their arms, and requests that arrive too late are dropped."""

import contextlib
import time

import pytest

from lerobot_robot_yam.errors import LifeCycleError, LinkError, MotorError, StaleStateError
from lerobot_robot_yam.remote import link as link_module
from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.remote.hosted_group import Phase
from lerobot_robot_yam.remote.link import Link
from lerobot_robot_yam.session import runners
from lerobot_robot_yam.session.arm_client import REQUEST_TIMEOUT_S
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Request
from lerobot_robot_yam.system.clock import SYSTEM
from tests.support.hosted import ServedArms
from tests.support.link_in_step import LinkInStep
from tests.support.rigged import rig_of, sim_config
from tests.support.waiting import wait

ARM = "follower_left"
POSE = [0.1, 0.2, 0.2, 0.0, 0.0, 0.1]
OTHER = {"group": "robot", "session": 5}  # another client
LATE_S = REQUEST_TIMEOUT_S + 0.2
PATIENT = pytest.mark.parametrize("fields", [{"max_state_age_s": 2.0}])  # after a stall no state is new


@pytest.fixture
def fields():
    """Fields of the arm's config, here and on the host."""
    return {}


@pytest.fixture
def host(fields):
    with rig_of("lockstep", arms=[ARM]) as rig, ServedArms(rig, ARM, **fields) as served:
        yield rig, served


@pytest.fixture
def stopped(monkeypatch):
    """The emergency stop is latched, and nothing lands; that is not waited for for long."""
    monkeypatch.setattr(runners, "LAND_TIMEOUT_S", 0.2)
    stop = EmergencyStop()
    stop.latch("a test")
    yield
    stop.release()


@pytest.fixture
def session(host, fields):
    rig, served = host
    device = HostedDevice(Host(served.address), "robot", ("",))
    session = ArmSession([sim_config(rig, ARM, **fields)], LinkInStep.on(served, device))
    session.start()
    yield session
    session.stop()


def let_go(served):
    """Have the host land the arms by itself, as it does when it has not heard its client for long."""
    (group,) = served.groups
    group.land("a test")
    wait(lambda: group.phase is Phase.FREE)


def drive(session):
    """Give targets, as a program that goes on does; none may be taken."""
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        session._runner._link.turn()
        with contextlib.suppress(StaleStateError):
            session[ARM].write_target(POSE, 0.5)
            pytest.fail("a target was taken that nobody carries out")


def test_a_client_hears_that_its_arms_were_let_go_and_does_not_see_anothers(host, session, monkeypatch):
    _, served = host
    (group,) = served.groups
    link = session._runner._link
    link._beat_s = 0.0
    link._beat(SYSTEM.now())
    let_go(served)
    assert Host(served.address).ask("start", 30.0, who="another", search=False, **OTHER)["ready"]
    monkeypatch.setattr(link_module, "_LOST_S", 0.05)  # it has heard nothing for longer: simulated time is quick
    link._take_echo(link._sockets.receive())  # from before the arms were let go: it waited while we stood still
    with pytest.raises(MotorError, match="has let go of the arms .another client may have them.; connect again"):
        drive(session)
    assert session.stop()
    assert group.phase is Phase.RUNNING and group.lease.holder == OTHER["session"]


def test_a_client_hears_that_its_arms_were_let_go_in_the_air(host, session, stopped):
    _, served = host
    let_go(served)
    with pytest.raises(MotorError, match="has let go of the arms"):
        drive(session)
    assert not session.stop()


def test_who_asks_again_whether_its_arms_are_down_hears_the_same(host, session, stopped):
    _, served = host
    ours, ask = {"group": "robot", "session": served.groups[0].lease.holder}, Host(served.address).ask
    assert [ask("stop", 30.0, **ours)["landed"] for _ in range(3)] == [False] * 3
    assert ask("stop", 30.0, **OTHER)["landed"]  # it never had them


@pytest.mark.parametrize("error", [LinkError, LifeCycleError])
def test_arms_are_let_go_when_their_start_is_given_up(error, monkeypatch):
    """Because it takes too long, or the program that waits has ended: before the gripper's stops have been found."""
    with contextlib.ExitStack() as ends:
        rig = ends.enter_context(rig_of("lockstep", arms=[ARM]))
        served = ends.enter_context(ServedArms(rig, ARM, gripper_stops_rad=None))
        link = Link(Host(served.address), {}, drives=True)
        ends.callback(link.close)
        while not link.up:
            link.turn()
        if error is LinkError:
            monkeypatch.setattr(link_module, "_START_S", 0.01)
        with pytest.raises(error, match="has not done it within|nobody waits for the arms any more"):
            link.start("robot", True, lambda: served.groups[0].phase is Phase.STARTING and error is LifeCycleError)
        assert served.groups[0].phase is Phase.FREE
        assert not any(motor["enabled"] for motor in rig.state()["arms"][ARM]["motors"].values())


def told(session, served):
    """Mode of the host's arm once it has the newest command, and has had the time to do what that says."""
    group, deadline = served.groups[0], time.monotonic() + 10.0
    before = group.newest
    while group.newest == before:
        assert time.monotonic() < deadline
        session._runner._link.turn()
    group._session.clock.sleep(0.1)
    return group._session[ARM].mode()


@PATIENT
@pytest.mark.parametrize(
    ("age_s", "mode", "dropped"), [(0.9 * REQUEST_TIMEOUT_S, Mode.FLOAT, 0), (LATE_S, Mode.HOLD, 1)]
)
def test_a_request_is_carried_out_only_while_its_caller_waits(host, session, age_s, mode, dropped):
    _, served = host
    session[ARM].ask(Request.FLOAT)
    served.groups[0]._session.clock.sleep(age_s)  # a stall of the network, by the clock of the arms
    assert told(session, served) is mode
    assert served.groups[0].dropped == dropped


@PATIENT
def test_a_target_does_not_bring_back_an_old_request(host, session):
    """The record of a new target has the last request in it, which the host has never seen."""
    _, served = host
    session[ARM].ask(Request.FLOAT)
    served.groups[0]._session.clock.sleep(LATE_S)
    session[ARM].write_target(POSE, 0.5)
    assert told(session, served) is Mode.TRACK
    assert served.groups[0].dropped == 1
