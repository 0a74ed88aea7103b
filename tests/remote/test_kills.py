"""Programs of either side killed at random moments, also while they start, and everything begun anew after each."""

import contextlib
import logging
import os
import random
import signal
import time

import pytest

from lerobot_robot_yam.state.link_faults import LinkFault
from tests.support.two_computers import LEADER, TwoComputers, check
from tests.support.workstation import AWAY, PHASES

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.timeout(1800)]

logger = logging.getLogger(__name__)

KILLS = 25
MOST_S = 9.0  # after its start; half of the kills come before the arms are under way
# What a program is told when it, or what it needs, is killed while it starts or drives.
TOLD = {"StaleStateError", "MotorError", "LinkError", "YamError", "LifeCycleError"}


def pids_of(lab, station, killed):
    """Processes to kill; none: there is none yet, or no more."""
    if killed is LinkFault.PROGRAM_DEAD:
        return [station.process.pid]
    if killed is LinkFault.LINK_PROCESS_DEAD:
        return station.link_pids()
    if killed is LinkFault.HOST_DEAD:
        return [lab.host.process.pid]
    return lab.control_pids()


@pytest.mark.parametrize("seed", [1, 2])
def test_kills_at_random(seed, tmp_path):
    draw = random.Random(seed)
    faults = [LinkFault.PROGRAM_DEAD, LinkFault.LINK_PROCESS_DEAD, LinkFault.HOST_DEAD, LinkFault.HOST_CONTROL_DEAD]
    with contextlib.ExitStack() as ends:
        lab = TwoComputers(tmp_path, ends)
        for number in range(KILLS):
            killed, phase, at_s = draw.choice(faults), draw.choice(PHASES), draw.uniform(0.2, MOST_S)
            logger.info("kill %d of seed %d: %s, %s, at %.2f s", number, seed, killed, phase, at_s)
            try:
                kill(lab, killed, phase, at_s)
            finally:
                lab.tidy()
        assert not [event for event in lab.rig.events() if event["kind"] == "motor_fault"]


def kill(lab, killed, phase, at_s):
    """Start all, kill one, and see how it ends."""
    station, begin, lifted = lab.start(phase), time.monotonic(), False
    while time.monotonic() < begin + at_s or not pids_of(lab, station, killed):
        assert time.monotonic() < begin + 60.0 and station.process.poll() is None, station.log()
        if phase == "engaged" and not lifted and station.said("connected"):
            lab.take(lab.rest + AWAY)
            lifted = True
        time.sleep(0.01)
    under_way = bool(station.said("phase"))
    for pid in pids_of(lab, station, killed):
        os.kill(pid, signal.SIGKILL)
    if under_way:
        check(lab, killed)
    lab.rig.release(LEADER)
    station.process.wait(90.0)
    assert set(station.said("error")) <= TOLD, station.said("text")
    assert station.said("wrong") == []
    lab.wait_down(90.0)
    assert station.left() == [] and lab.watch.findings == []
