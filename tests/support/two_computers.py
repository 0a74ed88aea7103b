"""A rig, a yam-host and a workstation with a wire between them: programs as a lab runs them, to be killed."""

import time

import numpy as np

from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.faults import Response
from lerobot_robot_yam.state.link_faults import LINK_RESPONSES
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.runtime_dirs import sessions
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.flaky_wire import FlakyWire
from tests.support.hosted import HostProcess, free_port, rig_file
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.rigged import sim_config
from tests.support.set_points import SetPointWatch
from tests.support.waiting import wait
from tests.support.workstation import AWAY, Workstation

ARM, LEADER = "follower_left", "leader_left"
LAND_AFTER_S = 4.0  # in place of 30
SLACK_S = 1.0  # of the machine: programs that start share it
_FRESH_S = 0.3
_WAY_S = 1.5  # of a hand


class TwoComputers:
    """A rig, a yam-host and a workstation with a wire between, all of which go on until something is killed.

    Attributes:
        watch: of the set-points of both arms.
    """

    def __init__(self, directory, ends):
        self._directory, self._ends = directory, ends
        self._station = None
        self.rig = rig = ends.enter_context(running_rig(arms=[ARM, LEADER]))
        self.rest = np.array(rig.state()["arms"][LEADER]["q"][:6])
        self._file = rig_file(directory, rig, arms=[ARM, LEADER], gate="auto")
        self.host = self._start_host(free_port())
        self.wire = ends.enter_context(FlakyWire(self.host.address))
        configs = [sim_config(rig, channel) for channel in (ARM, LEADER)]
        self.watch = ends.enter_context(SetPointWatch(rig.name, configs))

    def _start_host(self, port):
        host = HostProcess(self._file, self._directory, f"--land_after_s={LAND_AFTER_S}", port=port)
        self._ends.callback(host.end)
        host.wait()
        return host

    def start(self, phase, wired=False):
        """The workstation's program, over the wire or not, and the host anew where that was killed."""
        if self.host.process.poll() is not None:
            self.host = self._start_host(self.host.address.port)
        address = self.wire.address if wired else self.host.address
        self._station = Workstation(address, phase, self._directory / "ws")
        return self._station

    def tidy(self):
        """End the workstation's program, and whatever is wrong; all arms are down afterwards."""
        self.wire.stalled = False
        self.rig.release(LEADER)
        if self._station is not None:
            self._station.kill()
            if LEADER in self.torque():
                self.bring_home()
            try:
                self.wait_down()
            finally:
                self._station.end()

    def work(self, phase, wired=False):
        """The workstation, once it is in that phase."""
        station = self.start(phase, wired)
        station.wait_said("connected")
        if phase == "engaged":
            self.take(self.rest + AWAY)
        station.wait_said("phase")
        time.sleep(0.4)
        return station

    def take(self, q):
        """A hand brings the leader somewhere, and holds it there."""
        self.rig.hand(LEADER, [_WAY_S], [list(q)], 0.0, gives_way=False)

    def bring_home(self):
        """The hand brings the leader home, and lets go."""
        self.take(self.rest)
        time.sleep(_WAY_S + 0.3)
        self.rig.release(LEADER)

    @property
    def mode(self):
        """Of the follower, as its control loop says."""
        return Mode(int(self.watch.newest[ARM]["mode"]))

    def control_pids(self):
        """Of the process that drives the follower, if one does."""
        record = self.watch.newest[ARM]
        driven = record is not None and time.monotonic() - record["stamp_s"] < _FRESH_S
        return [int(record["owner_pid"])] if driven else []

    def torque(self):
        """Channels of arms that have some."""
        arms = self.rig.state()["arms"]
        return [channel for channel, arm in arms.items() if any(motor["enabled"] for motor in arm["motors"].values())]

    def wait_down(self, within_s=20.0):
        """Until all arms have landed, and the host has let go of them; none fell."""
        wait(lambda: not self.torque() and not sessions(runtime_dir()), within_s, self.host.said)
        time.sleep(0.5)
        for channel in (ARM, LEADER):
            assert moved_after_cut_m(self.rig, channel) < MOST_M, f"{channel} fell"


def check(lab, fault):
    """The follower does what the table says, as soon as that says."""
    rule = LINK_RESPONSES[fault]
    within_s = min(rule.within_s, LAND_AFTER_S) + SLACK_S
    if rule.arm is Response.LAND:
        wait(lambda: lab.mode in (Mode.LAND, Mode.OFF), within_s, lab.host.said)
    elif rule.arm is Response.HOLD_UNTIL_TARGET:
        wait(lambda: lab.mode is Mode.HOLD, within_s, lab.host.said)
    elif rule.arm is Response.STOP:
        wait(lambda: lab.mode is Mode.STOPPED, within_s, lab.host.said)
    else:
        assert rule.arm is Response.GO_ON
        deadline = time.monotonic() + 1.5
        while time.monotonic() < deadline:
            assert lab.mode is Mode.TRACK
            time.sleep(0.005)


def check_told(station, *errors):
    """The caller has heard of it, by an error of one of these kinds, and was never told what was old."""
    station.process.wait(60.0)
    (error,) = station.said("error")
    assert error in errors, station.said("text")
    assert station.said("wrong") == []
