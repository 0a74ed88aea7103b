"""A host that has let go of a client's arms, in lock-step: the client hears so, and whether they have come down."""

import contextlib
import time

import pytest

from lerobot_robot_yam.errors import LinkError, MotorError, StaleStateError
from lerobot_robot_yam.remote.client import link as link_module
from lerobot_robot_yam.remote.client.host_question import Host
from lerobot_robot_yam.remote.client.host_rig import HostedDevice
from lerobot_robot_yam.remote.client.link import Link
from lerobot_robot_yam.remote.client.state_mirror import StateMirror
from lerobot_robot_yam.remote.host.hosted_group import Phase
from lerobot_robot_yam.session import runners
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.records import COMMAND_DTYPE
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.hosted import ServedArms
from tests.support.link_in_step import LinkInStep
from tests.support.rigged import rig_of, sim_config

ARM = "follower_left"
POSE = [0.1, 0.2, 0.2, 0.0, 0.0, 0.1]
OTHER = {"group": "robot", "session": 5}  # another client


@pytest.fixture
def host():
    with rig_of("lockstep", arms=[ARM]) as rig, ServedArms(rig, ARM) as served:
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
def session(host):
    rig, served = host
    device = HostedDevice(Host(served.address), "robot", ("",))
    session = ArmSession([sim_config(rig, ARM)], LinkInStep.on(served, False, device))
    session.start()
    yield session
    session.stop()


def let_go(served):
    """Have the host land the arms by itself, as it does when it has not heard its client for long."""
    (group,) = served.groups
    group.land("a test")
    wait(lambda: group.phase is Phase.FREE)


def wait(condition):
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def drive(session):
    """Give targets, as a program that goes on does; none may be taken."""
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        session._runner._link.turn()
        with contextlib.suppress(StaleStateError):
            session[ARM].write_target(POSE, 0.5)
            pytest.fail("a target was taken that nobody carries out")


def test_a_client_hears_that_its_arms_were_let_go_and_does_not_see_anothers(host, session):
    _, served = host
    (group,) = served.groups
    let_go(served)
    assert Host(served.address).ask("start", 30.0, who="another", search=False, **OTHER)["ready"]
    with pytest.raises(MotorError, match="has let go of the arms .another client may have them.; connect again"):
        drive(session)
    assert session.stop()
    assert group.phase is Phase.RUNNING and group.holder.session == OTHER["session"]


def test_a_client_hears_that_its_arms_were_let_go_in_the_air(host, session, stopped):
    _, served = host
    let_go(served)
    with pytest.raises(MotorError, match="has let go of the arms"):
        drive(session)
    assert not session.stop()


def test_who_asks_again_whether_its_arms_are_down_hears_the_same(host, session, stopped):
    _, served = host
    ours, ask = {"group": "robot", "session": served.groups[0].holder.session}, Host(served.address).ask
    assert [ask("stop", 30.0, **ours)["landed"] for _ in range(3)] == [False] * 3
    assert ask("stop", 30.0, **OTHER)["landed"]  # it never had them


def test_arms_are_let_go_when_their_start_is_given_up(monkeypatch):
    """Before the stops of the gripper have been found."""
    monkeypatch.setattr(link_module, "_START_S", 0.01)
    with contextlib.ExitStack() as ends:
        rig = ends.enter_context(rig_of("lockstep", arms=[ARM]))
        served = ends.enter_context(ServedArms(rig, ARM, gripper_stops_rad=None))
        commands = ends.enter_context(contextlib.closing(SharedBlock(None, COMMAND_DTYPE, create=True)))
        link = Link(Host(served.address), StateMirror([], [], {}), {0: commands}, {})
        ends.callback(link.close)
        while not link.up:
            link.turn()
        with pytest.raises(LinkError, match="no yam-host answers"):
            link.start("robot", True, lambda: False)
        assert served.groups[0].phase is Phase.FREE
        assert not any(motor["enabled"] for motor in rig.state()["arms"][ARM]["motors"].values())
