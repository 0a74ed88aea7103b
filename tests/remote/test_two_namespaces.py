"""Host and client in two network namespaces with a cable between: paired, and unplugged for three seconds."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time

import pytest

from lerobot_robot_yam.remote.link_keys import pair
from lerobot_robot_yam.rig.control import running_rig
from tests.support.hosted import rig_file
from tests.support.paths import ROOT
from tests.support.rigged import sim_config
from tests.support.set_points import SetPointWatch
from tests.support.waiting import wait

ARM, ADDRESS = "follower_left", "10.34.0.1"
POSES = [[0.2, 0.5, 0.5, 0.0, 0.0, 0.1], [-0.2, 0.8, 0.9, 0.1, 0.2, -0.1]]


def ip(*words):
    return subprocess.run(["ip", *words], capture_output=True, text=True)


def may_make_namespaces():
    name = f"yam-{os.getpid()}"
    made = shutil.which("ip") is not None and os.getuid() == 0 and ip("netns", "add", name).returncode == 0
    return made and ip("netns", "del", name).returncode == 0


pytestmark = [
    pytest.mark.long,
    pytest.mark.alone,
    pytest.mark.skipif(not may_make_namespaces(), reason="network namespaces cannot be made here"),
]

CLIENT = """
import json, sys, time
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.session.arm_session import ArmSession
address, key, poses = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
device = HostedDevice(Host(HostAddress.of(address), key), "robot", ("",))
session = ArmSession([ArmConfig(**options) for options in device.options.values()], device.runner())
session.start()
arm = next(iter(session._clients.values()))
def go(pose):
    deadline = time.monotonic() + 2.0
    while time.monotonic() < deadline:
        try:
            arm.write_target(pose, 0.5)
        except StaleStateError:
            pass
        time.sleep(0.02)
    return float(abs(arm.observe().q - pose).max())
def wait(stale):
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            arm.observe()
            if not stale:
                return
        except StaleStateError:
            if stale:
                return
        time.sleep(0.01)
    raise SystemExit("it stays " + ("fresh" if not stale else "stale"))
print(json.dumps({"away": go(poses[0])}), flush=True)
wait(stale=True)
print(json.dumps({"stale": True}), flush=True)
wait(stale=False)
print(json.dumps({"away": go(poses[1])}), flush=True)
session.stop()
"""


@contextlib.contextmanager
def two_namespaces():
    """Names of both; the first has `ADDRESS`."""
    names = [f"yam-{os.getpid()}-{number}" for number in (1, 2)]
    try:
        for name in names:
            ip("netns", "add", name)
        ip("link", "add", "cable", "netns", names[0], "type", "veth", "peer", "name", "cable", "netns", names[1])
        for number, name in enumerate(names, 1):
            ip("-n", name, "address", "add", f"10.34.0.{number}/24", "dev", "cable")
            for device in ("lo", "cable"):
                assert ip("-n", name, "link", "set", device, "up").returncode == 0
        yield names
    finally:
        for name in names:
            ip("netns", "del", name)


def inside(name, *command, **options):
    """A program in a namespace."""
    return subprocess.Popen(["ip", "netns", "exec", name, sys.executable, *command], cwd=ROOT, text=True, **options)


def test_a_cable_between_two_computers(tmp_path):
    key = tmp_path / "key.json"
    pair(tmp_path / "keys", "workstation", key)
    with contextlib.ExitStack() as ends:
        here, there = ends.enter_context(two_namespaces())
        rig = ends.enter_context(running_rig(arms=[ARM]))
        file = rig_file(tmp_path, rig, arms=[ARM])
        said = ends.enter_context(open(tmp_path / "host.txt", "w"))
        words = ["-m", "lerobot_robot_yam.commands.servers.host", f"--config_path={file}", f"--listen={ADDRESS}"]
        host = inside(here, *words, f"--keys={tmp_path / 'keys'}", stdout=said, stderr=said)
        ends.callback(host.wait)
        ends.callback(host.terminate)
        wait(lambda: "listening" in (tmp_path / "host.txt").read_text(), 60.0, process=host)
        watch = ends.enter_context(SetPointWatch(rig.name, [sim_config(rig, ARM)]))
        client = inside(there, "-c", CLIENT, ADDRESS, str(key), json.dumps(POSES), stdout=subprocess.PIPE)
        ends.callback(client.wait)
        ends.callback(client.kill)
        assert json.loads(client.stdout.readline())["away"] < 0.05
        ip("-n", there, "link", "set", "cable", "down")
        assert json.loads(client.stdout.readline())["stale"]
        time.sleep(3.0)
        ip("-n", there, "link", "set", "cable", "up")
        assert json.loads(client.stdout.readline())["away"] < 0.05
        assert client.wait(30) == 0
    assert watch.findings == []
