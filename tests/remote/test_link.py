"""A session whose arms another process drives, over the link: as a session of local arms."""

import time

import numpy as np
import pytest

from lerobot_robot_yam.errors import (
    ChannelInUseError,
    ConfigError,
    LifeCycleError,
    LinkError,
    StaleStateError,
)
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host, hello
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.runtime_dirs import sessions
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.hosted import ServedArms, free_port
from tests.support.rigged import track
from tests.support.waiting import wait

pytestmark = pytest.mark.alone  # one session of a live rig serves all tests: a motor that is late fails them all

ARM = "follower_left"
POSE = [0.1, 0.2, 0.2, 0.0, 0.0, 0.1]


@pytest.fixture(scope="module")
def rig():
    with running_rig(arms=[ARM]) as rig:
        yield rig


@pytest.fixture(scope="module")
def served(rig):
    with ServedArms(rig, ARM, land_after_s=1.0) as served:
        yield served


@pytest.fixture(scope="module")
def session(served):
    session = served.session()
    session.start()
    yield session
    session.stop()


def test_the_arm_goes_where_its_targets_are(rig, session):
    track(session, {ARM: POSE}, 0.8)
    assert np.abs(session[ARM].observe().q - POSE).max() < 0.05
    assert np.abs(np.array(rig.state()["arms"][ARM]["q"][:6]) - POSE).max() < 0.05


def test_a_state_has_the_times_of_this_computer(session):
    begin = time.monotonic()
    state = session[ARM].observe()
    assert begin - 0.1 < state.stamp_s <= time.monotonic()
    assert state.asked_s <= state.published_s <= time.monotonic()


def test_requests_are_answered(session):
    arm = session[ARM]
    arm.float()
    assert arm.mode() is Mode.FLOAT
    with pytest.raises(LifeCycleError, match="takes no targets in mode float"):
        arm.write_target(POSE, 0.5)
    arm.hold()
    assert arm.mode() is Mode.HOLD


def test_an_emergency_stop_of_one_computer_alone_ends_with_its_release(session):
    """Host and client share the latch here: neither may tell the other of it, and latch it anew."""
    stop, arm = EmergencyStop(), session[ARM]
    for _ in range(3):
        stop.latch("a test")
        wait(lambda: arm.mode() is Mode.STOPPED, 5.0)
        stop.release()
        wait(lambda: arm.mode() is Mode.HOLD, 5.0)
        time.sleep(0.2)  # what was on its way has come
        assert not stop.latched


def test_nobody_cuts_torque_from_afar(session):
    with pytest.raises(StaleStateError, match="does not answer"):
        session[ARM].cut_torque()
    assert session[ARM].mode() is not Mode.OFF
    session[ARM].hold()  # the next request is answered all the same


def test_gains_are_changed_and_checked(session):
    arm = session[ARM]
    kp, kd = arm.kp.copy(), arm.kd.copy()
    arm.change_gains(0.9 * kp, kd)
    with pytest.raises(ConfigError, match="kd"):
        arm.change_gains(kp, 0.01 * kd)
    arm.change_gains(kp, kd)


def test_others_watch_but_do_not_drive(served, session):
    (key,) = [key for key in sessions(runtime_dir()) if key.startswith("remote.")]
    assert key == f"remote.127.0.0.1-{served.address.port}-{ARM}"
    told = hello(Host(served.address))
    assert f"process {sessions(runtime_dir())[key]}" in told["groups"]["robot"]["holder"]
    # On this computer the channel's lock says so already, on another one the host would.
    with pytest.raises(ChannelInUseError, match="in use by process"):
        served.session().start()


@pytest.mark.long
def test_who_does_not_answer_is_named():
    address = HostAddress("127.0.0.1", free_port())
    with pytest.raises(LinkError, match=f"no yam-host answers at {address} within 2 s"):
        HostedDevice(Host(address), "robot", ("",))


def test_a_group_that_is_not_there_is_refused(served):
    with pytest.raises(ConfigError, match="has no teleop; it has robot"):
        HostedDevice(Host(served.address), "teleop", ("",))
    with pytest.raises(ConfigError, match="is a yam_follower; its type here is yam_remote"):
        HostedDevice(Host(served.address), "robot", ("left_", "right_"))
