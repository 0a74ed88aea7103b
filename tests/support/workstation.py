"""A workstation's program that drives one arm over the link, to be killed: run, and watched by `Workstation`.

`python -m tests.support.workstation ADDRESS PHASE`. It reads states as fast as LeRobot does, and tells in lines of JSON
what must not be: a state that is older than stated, one that comes after a later one. An error of ours ends it, and it
lets go of its arms, as a stock command does.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Gate
from tests.support.paths import ROOT
from tests.support.waiting import wait

PHASES = ("idle", "engaged", "policy", "homing")
AWAY = (0.2, 0.9, 0.9, 0.0, 0.0, 0.1)
_PERIOD_S = 1.0 / 60.0
_AWAY_S = 2.0
_END_S = 15.0


class Caller:
    """What the program does, in one phase: nothing, what a policy says, or what a leader does.

    Args:
        address: of the host.
        phase: one of `PHASES`; with "homing" the follower is away from home when the leader connects.
    """

    def __init__(self, address, phase):
        self._phase, self._told = phase, False
        self._sessions = [self._connected(address, "robot")]
        self._begin_s, self._tick = time.monotonic(), 0
        try:
            if phase in ("engaged", "homing"):
                while phase == "homing" and time.monotonic() < self._begin_s + _AWAY_S:
                    self._arm.write_target(AWAY, 0.5)
                    time.sleep(_PERIOD_S)
                self._sessions.append(self._connected(address, "teleop"))
        except YamError:
            self.close()
            raise
        tell(connected=phase)

    @staticmethod
    def _connected(address, group):
        device = HostedDevice(Host(address), group, ("",))
        (options,) = device.options.values()
        known = {name: value for name, value in options.items() if name in ArmConfig.__dataclass_fields__}
        session = ArmSession([ArmConfig(**known)], device.runner())
        session.start()
        return session

    @property
    def _arm(self):
        return next(iter(self._sessions[0]._clients.values()))

    def turn(self):
        """Look, and do."""
        begin, arm = time.monotonic(), self._arm
        state = arm.observe()
        now = time.monotonic()
        if (age_s := now - state.stamp_s) > arm.config.max_state_age_s + now - begin:
            tell(wrong=f"a state is {age_s:.3f} s old, looked at within {now - begin:.3f} s")
        if state.tick < self._tick:
            tell(wrong=f"tick {state.tick} comes after {self._tick}")
        self._tick, gate = state.tick, None
        if self._phase == "policy":
            swing = abs((now - self._begin_s) % 2.0 - 1.0)
            arm.write_target([0.2, 0.4 + 0.6 * swing, 0.7, 0.0, 0.3 * swing, 0.1], swing)
        elif len(self._sessions) > 1:
            (leader,) = self._sessions[1]._clients.values()
            lead = leader.observe()
            gate = lead.gate
            action = state.action if state.coupled else lead.action
            if action is not None:
                key = self._sessions[1].key(leader.config.name)
                arm.write_target(action[:6], action[6], leader=key)
        if not self._told and gate in (None, {"engaged": Gate.ENGAGED, "homing": Gate.HOMING}.get(self._phase)):
            self._told = True
            tell(phase=self._phase)

    def close(self):
        """Land."""
        for session in reversed(self._sessions):
            session.stop()


def tell(**fields):
    """A line of JSON."""
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def main(address, phase):
    """Drive until an error comes; returns the exit status."""
    with contextlib.ExitStack() as ends:
        try:
            caller = ends.enter_context(contextlib.closing(Caller(HostAddress.of(address), phase)))
            while True:
                caller.turn()
                time.sleep(_PERIOD_S)
        except YamError as error:
            tell(error=type(error).__name__, text=str(error))
    return 1


class Workstation:
    """The program, in a computer of its own: with a runtime directory that is its own.

    Args:
        address: of the host.
        phase: one of `PHASES`.
        runtime: its runtime directory.
    """

    def __init__(self, address, phase, runtime):
        self.runtime = Path(runtime)
        self.runtime.mkdir(mode=0o700, exist_ok=True)
        self._said = self.runtime.with_suffix(".txt")
        with open(self._said, "wb") as said, open(self.runtime.with_suffix(".log"), "ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.support.workstation", str(address), phase],
                cwd=ROOT,
                stdout=said,
                stderr=log,
                stdin=subprocess.DEVNULL,
                env=os.environ | {"YAM_RUNTIME_DIR": str(self.runtime)},
                start_new_session=True,
            )

    def said(self, name):
        """What it has told under a name."""
        rows = [json.loads(line) for line in self._said.read_text().splitlines() if line.endswith("}")]
        return [row[name] for row in rows if name in row]

    def log(self):
        """What it has printed besides."""
        return self.runtime.with_suffix(".log").read_text(errors="replace")[-4000:]

    def wait_said(self, name, within_s=40.0):
        """Until it has told something under a name."""
        wait(lambda: self.said(name), within_s, lambda: f"{self.said('text')} {self.log()}", self.process)

    def kill(self):
        """As nothing can be caught of it."""
        self.process.kill()
        self.process.wait()

    def link_pids(self):
        """Of its link processes."""
        return [pid for pid in self.pids() if b"link_process" in Path(f"/proc/{pid}/cmdline").read_bytes()]

    def pids(self):
        """Of all processes of this computer."""
        mark, found = f"YAM_RUNTIME_DIR={self.runtime}\0".encode(), []
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError):
                if entry.name.isdigit() and mark in (entry / "environ").read_bytes():
                    found.append(int(entry.name))
        return found

    def left(self):
        """Processes and files of its runtime directory that are still there some seconds later."""
        deadline = time.monotonic() + _END_S
        while (found := [*self.pids(), *self.runtime.iterdir()]) and time.monotonic() < deadline:
            time.sleep(0.05)
        return found

    def end(self):
        """Whatever has become of it: leave no process behind."""
        for pid in self.pids():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
