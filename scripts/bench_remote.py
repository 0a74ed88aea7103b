"""Measure what the link between two computers adds: age of samples, latency of commands, processor time.

    python scripts/bench_remote.py --json outputs/bench_remote.json

Two arms of the virtual rig on one computer, over its loopback; a client at 60 Hz. Takes about a minute; `--quick` a
short look. Both sides have one clock here, so that every time is true. Beside it, with nothing to drive:

- LeRobot's own pattern for a robot elsewhere (lerobot/robots/lekiwi: a loop that takes a command, reads, and sends
  JSON), at its rate and at ours;
- the vendor's (i2rt, scripts/minimum_gello.py: a server of calls per arm), where `portal` is installed
  (`pip install portal`).
"""

import argparse
import contextlib
import dataclasses
import json
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from bench.remote_peers import RATE_HZ, cpu_s, lekiwi, percentiles, portal_calls

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import LinkError
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host, hello
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.runtime_files import runtime_dir, sessions
from lerobot_robot_yam.system.shared_block import SharedBlock

ROOT = Path(__file__).resolve().parent.parent
ARMS = ("follower_left", "follower_right")
PORT = 5690
_LOOK_S = 0.00005
_AT = {name: STATE_DTYPE.fields[name][1] for name in ("tick", "target_sequence")}  # type: ignore[index]


class Watch:
    """Notes when each tick of an arm, and each target taken, can be read from a block."""

    def __init__(self, path: Path):
        self._block = SharedBlock(path, STATE_DTYPE, create=False)
        self.ticks: dict[int, float] = {}
        self.taken: dict[int, float] = {}
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._look)
        self._thread.start()

    def _look(self) -> None:
        seen = 0
        while not self._end.is_set():
            sequence = self._block.sequence()
            if sequence != seen and (payload := self._block.glance_bytes()) is not None:
                seen, now = sequence, time.monotonic()
                tick, target = (int.from_bytes(payload[at : at + 8], "little") for at in _AT.values())
                self.ticks.setdefault(tick, now)
                self.taken.setdefault(target, now)
            time.sleep(_LOOK_S)

    def close(self) -> None:
        """End."""
        self._end.set()
        self._thread.join()
        self._block.close()


def drive(session: ArmSession, watch: Watch, seconds: float) -> list[float]:
    """Send targets at 60 Hz; returns how long each took until the loop had it."""
    given = []
    q = session[ARMS[0]].observe().q
    first = max(watch.taken, default=0)
    begin = time.monotonic()
    for number in range(int(seconds * RATE_HZ)):
        target = q + 0.05 * np.sin(number / RATE_HZ * 2.0)
        for name in ARMS:
            session[name].observe()
        time.sleep(random.uniform(0.0, 0.004))  # a reader comes right after a tick, a policy takes its time
        now = time.monotonic()
        for name in ARMS:
            session[name].write_target(target, 0.5)
        given.append(now)
        time.sleep(max(0.0, begin + (number + 1) / RATE_HZ - time.monotonic()))
    time.sleep(0.1)
    return [taken - given[n - first - 1] for n, taken in watch.taken.items() if 0 <= n - first - 1 < len(given)]


def config(rig: Any, channel: str) -> ArmConfig:
    return ArmConfig(
        name=channel,
        channel=channel,
        interface="yam_sim",
        can_options={"rig": rig.name},
        gravity_factor=[1.0] * 6,
        gripper_stops_rad=[3.25, -3.3],
    )


@contextlib.contextmanager
def hosting(rig: Any, directory: Path) -> Iterator[tuple[HostAddress, int]]:
    """yam-host for both arms."""
    arms = [dataclasses.asdict(config(rig, channel)) for channel in ARMS]
    kept = ("channel", "interface", "can_options", "gravity_factor", "gripper_stops_rad", "name")
    left, right = ({name: arm[name] for name in kept} for arm in arms)
    robot = {"type": "bi_yam_follower", "left_arm_config": left, "right_arm_config": right}
    (directory / "rig.yaml").write_text(json.dumps({"robot": robot}))
    address = HostAddress("127.0.0.1", PORT)
    command = ["-m", "lerobot_robot_yam.commands.servers.host", f"--config_path={directory / 'rig.yaml'}"]
    command += [f"--listen={address}", f"--keys={directory / 'keys'}"]
    with open(directory / "host.txt", "wb") as said:
        process = subprocess.Popen([sys.executable, *command], cwd=ROOT, stdout=said, stderr=said)
    try:
        while True:
            if process.poll() is not None:
                raise RuntimeError(f"yam-host has ended: {(directory / 'host.txt').read_text()}")
            with contextlib.suppress(LinkError):
                hello(Host(address))
                break
        yield address, process.pid
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def over_the_link(rig: Any, directory: Path, seconds: float) -> dict[str, Any]:
    with hosting(rig, directory) as (address, host_pid):
        device = HostedDevice(Host(address), "robot", ("left_", "right_"))
        session = ArmSession([ArmConfig(**options) for options in device.options.values()], device.runner())
        session.start()
        (link_pid,) = {int(pid) for key, pid in sessions(runtime_dir()).items() if key.startswith("remote.")}
        there = Watch(state_path(channel_key("yam_sim", ARMS[0], rig.name)))
        here = Watch(state_path(session.key(ARMS[0])))
        try:
            time.sleep(1.0)
            begin, before = time.monotonic(), [cpu_s(pid) for pid in (host_pid, link_pid)]
            latency = drive(session, there, seconds)
            took = time.monotonic() - begin
            used = [(cpu_s(pid) - b) / took for pid, b in zip((host_pid, link_pid), before, strict=True)]
            ages = [
                seen - there.ticks[tick] for tick, seen in here.ticks.items() if tick in there.ticks and seen > begin
            ]
        finally:
            there.close()
            here.close()
            session.stop()
    row = {"added_age": percentiles(ages), "latency": percentiles(latency)}
    return row | {"host_cpu": round(used[0], 4), "link_cpu": round(used[1], 4), "states": len(ages)}


def local(rig: Any, seconds: float) -> dict[str, Any]:
    session = ArmSession([config(rig, channel) for channel in ARMS])
    session.start()
    watch = Watch(state_path(session.key(ARMS[0])))
    try:
        return {"latency": percentiles(drive(session, watch, seconds))}
    finally:
        watch.close()
        session.stop()


def main() -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--quick", action="store_true", help="a short look")
    args = parser.parse_args()
    seconds = 3.0 if args.quick else 15.0
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as directory, running_rig(arms=list(ARMS)) as rig:
        cases: dict[str, Callable[[], dict[str, Any]]] = {
            "local": lambda: local(rig, seconds),
            "link": lambda: over_the_link(rig, Path(directory), seconds),
            "lekiwi at 30 Hz": lambda: lekiwi(30.0, seconds, PORT + 5),
            "lekiwi at 250 Hz": lambda: lekiwi(250.0, seconds, PORT + 5),
        }
        if find_spec("portal") is None:
            print("the vendor's pattern is left out: portal is not installed (pip install portal)")
        else:
            cases["portal"] = lambda: portal_calls(seconds, [PORT + 10, PORT + 11])
        for name, measure in cases.items():
            rows[name] = measure()
            print(name, json.dumps(rows[name]), flush=True)
    added = {p: round(rows["link"]["latency"][p] - rows["local"]["latency"][p], 2) for p in ("p50_ms", "p99_ms")}
    rows["link"]["added_latency"] = added
    print("added latency", json.dumps(added))
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
