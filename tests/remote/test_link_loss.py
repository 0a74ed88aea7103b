"""What arms do when the link is slow, stalls, breaks, or one of its ends is killed: docs/two-machines.md says it."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.commands.estop import main as yam_estop
from lerobot_robot_yam.errors import MotorError, StaleStateError
from lerobot_robot_yam.remote.client.host_question import Host
from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.flaky_wire import FlakyWire
from tests.support.hosted import HostProcess, ServedArms, rig_file, running_host
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.paths import ROOT
from tests.support.rigged import sim_config
from tests.support.set_points import SetPointWatch

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


def wait(condition, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def down(rig, channel=ARM):
    """Whether every motor is off."""
    return not any(motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values())


def enabled(rig, channel=ARM):
    return all(motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values())


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


def test_a_request_that_failed_in_a_stall_is_not_carried_out_after_it(wired):
    """Neither as it arrives at last, nor with the next target, whose record has it, too."""
    session, wire, served = wired
    session.start()
    lead(session, POSES[0], 1.0)
    host_arm = served.groups[0]._session[ARM]
    for broken in (False, True):
        wire.stalled = True
        if broken:
            wire.drop()
        with pytest.raises(StaleStateError):
            session[ARM].float()
        time.sleep(0.3)
        wire.stalled = False
        observe(session)
        time.sleep(0.5)
        assert host_arm.mode() is Mode.HOLD
        assert np.abs(lead(session, POSES[1]).q - POSES[1]).max() < 0.05
        assert host_arm.mode() in (Mode.HOLD, Mode.TRACK) and served.groups[0].dropped > 0


def test_a_program_that_was_idle_hears_that_its_arm_was_let_go(rig, wired):
    """It does not see, nor seem to drive, what another one does with the arm."""
    session, wire, served = wired
    session.start()
    wire.stalled = True
    wait(lambda: served.groups[0].holder is None and down(rig), 20.0)
    Host(served.address).ask("start", 30.0, group="robot", session=5, who="another", search=False)
    wire.stalled = False
    deadline = time.monotonic() + 10.0
    with pytest.raises(MotorError, match="has let go of the arms"):
        while time.monotonic() < deadline:
            with contextlib.suppress(StaleStateError):
                session[ARM].write_target(POSES[0], 0.5)
                pytest.fail("a target was taken that nobody carries out")
            time.sleep(0.005)
    assert session.stop() and enabled(rig)


def test_a_broken_connection_is_made_again(wired):
    session, wire, _ = wired
    session.start()
    for pose in POSES:
        wire.drop()
        time.sleep(1.5)
        assert np.abs(lead(session, pose).q - pose).max() < 0.05


def test_a_client_that_is_silent_for_long_has_its_arm_landed(rig, wired):
    session, wire, served = wired
    session.start()
    lead(session, POSES[0], 1.0)
    wire.stalled = True
    time.sleep(3.0)
    assert enabled(rig)
    wait(lambda: down(rig), 15.0)
    assert moved_after_cut_m(rig, ARM) < MOST_M
    wire.stalled = False
    wait(lambda: served.groups[0].holder is None)


CLIENT = """
import sys, time
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.remote.client.host_question import Host
from lerobot_robot_yam.remote.client.host_rig import HostedDevice
from lerobot_robot_yam.remote.wire.host_address import HostAddress
from lerobot_robot_yam.session.arm_session import ArmSession
device = HostedDevice(Host(HostAddress.of(sys.argv[1])), "robot", ("",))
session = ArmSession([ArmConfig(**options) for options in device.options.values()], device.runner())
session.start()
begin = time.monotonic()
while True:
    pose = [0.2, 0.5 + 0.3 * abs((time.monotonic() - begin) % 2.0 - 1.0), 0.6, 0.0, 0.0, 0.0]
    for arm in session._clients.values():
        arm.observe()
        arm.write_target(pose, 0.5)
    time.sleep(0.016)
"""


def test_a_killed_workstation_has_its_arm_landed(rig, tmp_path):
    """In any moment: its link process has the host land it, as a control process lands by itself."""
    draw = random.Random(3)
    with ServedArms(rig, ARM) as served, SetPointWatch(rig.name, [sim_config(rig, ARM)]) as watch:
        for _ in range(8):
            command = [sys.executable, "-c", CLIENT, str(served.address)]
            with open(tmp_path / "said.txt", "ab") as said:
                client = subprocess.Popen(command, cwd=ROOT, stdout=said, stderr=said, start_new_session=True)
            wait(lambda: enabled(rig), 30.0)
            time.sleep(draw.uniform(0.0, 2.0))
            os.kill(client.pid, signal.SIGKILL)
            client.wait()
            wait(lambda: down(rig), 15.0)
            assert moved_after_cut_m(rig, ARM) < MOST_M
            wait(lambda: served.groups[0].holder is None)
            wait(lambda: not list(runtime_dir().glob("*remote*")))
    assert watch.findings == []


def test_a_killed_host_lands_its_arm_and_the_caller_hears_it(rig, tmp_path):
    file = rig_file(tmp_path, rig, arms=[ARM])
    host = HostProcess(file, tmp_path)
    try:
        host.wait()
        command = [sys.executable, "-c", CLIENT, str(host.address)]
        with open(tmp_path / "said.txt", "wb") as said:
            client = subprocess.Popen(command, cwd=ROOT, stdout=said, stderr=said, start_new_session=True)
        wait(lambda: enabled(rig), 30.0)
        time.sleep(1.0)
        host.process.kill()
        host.process.wait()
        wait(lambda: down(rig), 15.0)
        assert moved_after_cut_m(rig, ARM) < MOST_M
        assert client.wait(30) == 1 and "StaleStateError" in (tmp_path / "said.txt").read_text()
    finally:
        host.end()


def test_the_emergency_stop_of_each_computer_is_that_of_both(rig, tmp_path, monkeypatch, capsys):
    theirs, ours = runtime_dir(), tmp_path / "ws"
    ours.mkdir(mode=0o700)
    with running_host(rig_file(tmp_path, rig, arms=[ARM]), tmp_path) as host:
        monkeypatch.setenv("YAM_RUNTIME_DIR", str(ours))
        there, here = EmergencyStop(theirs), EmergencyStop()
        session = ServedArms.session_at(host.address, ("",))
        session.start()
        name = next(iter(session._arms))
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
