"""Each fault of the link in each phase, between programs as a lab runs them: the arms, the caller, what is left.

What is expected is read from `link_faults.LINK_RESPONSES`; a row that is changed there and not in the code fails here.
"""

import contextlib
import os
import signal
import time

import pytest

from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.remote.host_question import Host, hello
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.link_faults import LinkFault
from lerobot_robot_yam.state.modes import Mode
from tests.support.hosted import ServedArms
from tests.support.two_computers import LAND_AFTER_S, LEADER, TwoComputers, check, check_told
from tests.support.waiting import wait
from tests.support.workstation import PHASES

pytestmark = [pytest.mark.long, pytest.mark.alone]


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    with contextlib.ExitStack() as ends:
        yield TwoComputers(tmp_path_factory.mktemp("lab"), ends)


@pytest.fixture
def lab(both):
    yield both
    both.tidy()
    assert both.watch.findings == []


@pytest.mark.parametrize("phase", PHASES)
def test_the_program_is_killed(lab, phase):
    station = lab.work(phase)
    station.kill()
    check(lab, LinkFault.PROGRAM_DEAD)
    lab.rig.release(LEADER)
    lab.wait_down()
    assert station.left() == [] and station.said("wrong") == []
    wait(lambda: {group["phase"] for group in hello(Host(lab.host.address))["groups"].values()} == {"free"}, 10.0)
    lab.work("idle").kill()  # and it can be had again
    lab.wait_down()


@pytest.mark.parametrize("phase", PHASES)
def test_the_whole_workstation_is_gone(lab, phase):
    station = lab.work(phase)
    for pid in [*station.link_pids(), station.process.pid]:  # else a link process may still ask the host to land
        os.kill(pid, signal.SIGKILL)
    station.process.wait()
    check(lab, LinkFault.WORKSTATION_DEAD)
    if phase == "engaged":
        time.sleep(LAND_AFTER_S + 1.0)
        assert len(lab.torque()) == 2
        lab.bring_home()
    lab.wait_down()
    assert not station.pids()


@pytest.mark.parametrize("phase", ["engaged", "policy"])
def test_the_link_process_is_killed(lab, phase):
    station = lab.work(phase)
    for pid in station.link_pids():
        os.kill(pid, signal.SIGKILL)
    check(lab, LinkFault.LINK_PROCESS_DEAD)
    lab.bring_home()
    check_told(station, "StaleStateError")
    lab.wait_down()
    assert station.left() == []


@pytest.mark.parametrize("phase", ["idle", "engaged", "policy"])
def test_the_hosts_control_process_is_killed(lab, phase):
    station = lab.work(phase)
    for pid in lab.control_pids():
        os.kill(pid, signal.SIGKILL)
    check(lab, LinkFault.HOST_CONTROL_DEAD)
    lab.rig.release(LEADER)
    check_told(station, "StaleStateError", "MotorError")
    lab.wait_down()
    assert station.left() == []


def test_a_short_cut_changes_nothing(lab):
    station = lab.work("policy", wired=True)
    lab.wire.stalled = True
    time.sleep(0.15)
    lab.wire.stalled = False
    check(lab, LinkFault.LINK_BRIEFLY_CUT)
    assert station.process.poll() is None and station.said("wrong") == []


@pytest.mark.parametrize("phase", ["engaged", "policy", "homing"])
def test_a_cut_holds_the_arms(lab, phase):
    station = lab.work(phase, wired=True)
    lab.wire.stalled = True
    check(lab, LinkFault.LINK_CUT)
    station.wait_said("error")
    lab.wire.stalled = False
    lab.rig.release(LEADER)
    check_told(station, "StaleStateError")
    lab.wait_down()
    assert station.left() == []


def test_a_link_that_stays_away_lands_the_arms(lab):
    station = lab.work("policy", wired=True)
    lab.wire.stalled = True
    time.sleep(LAND_AFTER_S - 1.0)
    assert lab.mode is Mode.HOLD
    check(lab, LinkFault.LINK_GONE)
    check_told(station, "StaleStateError")
    lab.wait_down()
    lab.wire.stalled = False
    assert station.left() == []


@pytest.mark.parametrize("fault", [LinkFault.WORKSTATION_STOP, LinkFault.HOST_STOP])
def test_an_emergency_stop_of_either_side(lab, fault):
    station = lab.work("policy")
    stop = EmergencyStop(station.runtime if fault is LinkFault.WORKSTATION_STOP else None)
    stop.latch("a test")
    try:
        check(lab, fault)
        time.sleep(0.5)
        assert station.process.poll() is None and lab.mode is Mode.STOPPED
    finally:
        stop.release()
    wait(lambda: lab.mode is Mode.TRACK, 2.0)
    assert station.process.poll() is None and station.said("wrong") == []


def test_a_second_client_changes_nothing(lab):
    station = lab.work("policy")
    with pytest.raises(ChannelInUseError, match=r"driven by .*@.* \(process \d+\); end that first"):
        ServedArms.session_at(lab.host.address, ("",)).start()
    check(lab, LinkFault.SECOND_CLIENT)
    assert station.process.poll() is None and station.said("wrong") == []


# From here on the host is killed by each test: a new one may not outlive the test that starts it.


@pytest.mark.parametrize("phase", PHASES)
def test_the_host_is_killed(lab, phase):
    station = lab.work(phase)
    lab.host.process.kill()
    check(lab, LinkFault.HOST_DEAD)
    lab.rig.release(LEADER)
    check_told(station, "StaleStateError")
    lab.wait_down()
    assert station.left() == []


def test_a_host_is_killed_while_it_energises(lab):
    station = lab.start("idle")
    wait(lambda: lab.torque(), 30.0, station.log)
    lab.host.process.kill()
    station.process.wait(20.0)
    assert set(station.said("error")) <= {"LinkError", "StaleStateError"}, station.said("text")
    lab.wait_down()
    assert station.left() == []
