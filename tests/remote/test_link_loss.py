"""What arms do when the link is slow, stalls or breaks, and the emergency stop of both (docs/two-machines.md)."""

import contextlib
import time

import numpy as np
import pytest

from lerobot_robot_yam.commands.estop import main as yam_estop
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.flaky_wire import FlakyWire
from tests.support.hosted import ServedArms, rig_file, running_host
from tests.support.rigged import sim_config
from tests.support.set_points import SetPointWatch
from tests.support.waiting import wait

pytestmark = [pytest.mark.long, pytest.mark.alone]

ARM = "follower_left"
POSES = [[0.2, 0.5, 0.5, 0.0, 0.0, 0.1], [-0.2, 0.8, 0.9, 0.1, 0.2, -0.1]]


@pytest.fixture(scope="module")
def rig():
    with running_rig(arms=[ARM]) as rig:
        yield rig


@pytest.fixture
def wired(rig):
    """(session over a wire, the wire, the host), not yet started; the arm's set-point is judged in every state."""
    with ServedArms(rig, ARM, land_after_s=5.0) as served, FlakyWire(served.address) as wire:
        with SetPointWatch(rig.name, [sim_config(rig, ARM)]) as watch:
            session = served.session(address=wire.address)
            yield session, wire, served
            session.stop()
        assert watch.findings == []


def observe(session):
    """The arm's state once there is a fresh one: relay and host are threads of this process, which may stand still."""
    deadline = time.monotonic() + 10.0
    while True:
        try:
            return session[ARM].observe()
        except StaleStateError:
            assert time.monotonic() < deadline
            time.sleep(0.01)


def lead(session, pose, seconds=1.5):
    """Give an arm a target again and again, whatever the link does; returns its state then."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        with contextlib.suppress(StaleStateError):
            session[ARM].write_target(pose, 0.5)
        time.sleep(0.02)
    return observe(session)


@pytest.mark.parametrize(("delay_s", "loss"), [(0.005, 0.0), (0.02, 0.01), (0.08, 0.0)])
def test_a_slow_link_drives_the_arm_and_says_how_old_its_states_are(wired, delay_s, loss):
    session, wire, _ = wired
    wire.delay_s, wire.loss = delay_s, loss
    session.start()
    for pose in POSES:
        lead(session, pose)
        time.sleep(2.0 * delay_s)
        state = observe(session)
        assert np.abs(state.q - pose).max() < 0.05 and state.mode in (Mode.HOLD, Mode.TRACK)
        assert time.monotonic() - state.stamp_s > 0.9 * delay_s


def test_a_stall_holds_the_arm_and_tells_the_caller_and_then_it_goes_on(wired):
    session, wire, served = wired
    session.start()
    lead(session, POSES[0], 1.0)
    wire.stalled = True
    with pytest.raises(StaleStateError, match="old"):
        deadline = time.monotonic() + 2.0
        while time.monotonic() < deadline:
            session[ARM].observe()
            session[ARM].write_target(POSES[1], 0.5)
    host_arm = served.groups[0]._session[ARM]
    wait(lambda: host_arm.published().mode is Mode.HOLD)
    assert Limited.COMMAND_TIMEOUT in host_arm.published().limited
    held = host_arm.published().setpoint_q
    time.sleep(2.0)
    wire.stalled = False
    observe(session)
    time.sleep(0.5)
    assert np.abs(observe(session).setpoint_q - held).max() < 0.01  # old commands have no effect
    assert np.abs(lead(session, POSES[1]).q - POSES[1]).max() < 0.05


def test_a_broken_connection_is_made_again(wired):
    session, wire, _ = wired
    session.start()
    for pose in POSES:
        wire.drop()
        time.sleep(1.5)
        assert np.abs(lead(session, pose).q - pose).max() < 0.05


def test_the_emergency_stop_of_each_computer_is_that_of_both(rig, tmp_path, monkeypatch, capsys):
    theirs, ours = runtime_dir(), tmp_path / "ws"
    ours.mkdir(mode=0o700)
    with running_host(rig_file(tmp_path, rig, arms=[ARM]), tmp_path) as host:
        monkeypatch.setenv("YAM_RUNTIME_DIR", str(ours))
        there, here = EmergencyStop(theirs), EmergencyStop()
        session = ServedArms.session_at(host.address, ("",))
        session.start()
        name = next(iter(session._parts))
        try:
            here.latch("somebody shouted")
            wait(lambda: session[name].mode() is Mode.STOPPED)
            assert there.reason().startswith("workstation ")
            here.release()
            wait(lambda: session[name].mode() is Mode.HOLD)
            assert not there.latched and not here.latched
            assert yam_estop(["--host", str(host.address), "--why", "a test"]) == 0
            wait(lambda: session[name].mode() is Mode.STOPPED and here.latched)
            assert here.reason().startswith(f"host {host.address}: ")
            here.release()  # what came from there is released there
            wait(lambda: here.latched)
            assert yam_estop(["status", "--host", str(host.address)]) == 1
            assert "a test" in capsys.readouterr().out
            assert yam_estop(["release", "--host", str(host.address)]) == 0
            wait(lambda: session[name].mode() is Mode.HOLD and not here.latched)
        finally:
            there.release()
            session.stop()
    assert list(ours.iterdir()) == []
