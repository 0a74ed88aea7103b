"""A host of a virtual rig's arms, in a thread of the tests or run as a user runs it."""

import contextlib
import dataclasses
import os
import socket
import subprocess
import sys
import threading
import time

import yaml

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import LinkError
from lerobot_robot_yam.mobile.base_config import BASE_PREFIX, BaseConfig
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host, hello
from lerobot_robot_yam.remote.host_server import HostServer
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.remote.hosted_group import HostedGroup
from lerobot_robot_yam.remote.link_sockets import HostSockets
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.paths import ROOT
from tests.support.rigged import STOPS, base_on, isolation_of, sim_config

BASE_CHANNEL = "base"
FOLLOWERS, LEADERS = ("follower_left", "follower_right"), ("leader_left", "leader_right")
_START_S = 60.0


def free_port():
    """A port whose next one is free, too."""
    while True:
        with socket.socket() as first, socket.socket() as second:
            first.bind(("127.0.0.1", 0))
            port = first.getsockname()[1]
            with contextlib.suppress(OSError, OverflowError):
                second.bind(("127.0.0.1", port + 1))
                return port


def rig_file(directory, rig, arms=FOLLOWERS + LEADERS, **leads):
    """The file of a rig with these arms. `leads`: options of leaders, each of which then leads its follower."""
    document = {}
    for section, role, gripper in (("robot", "follower", "linear_4310"), ("teleop", "leader", "yam_teaching_handle")):
        own = {}
        for channel in (channel for channel in arms if channel.startswith(role)):
            arm = {"channel": channel, "gripper": gripper, "interface": "yam_sim", "can_options": {"rig": rig.name}}
            arm["gravity_factor"] = [1.0] * 6
            if role == "follower":
                arm["gripper_stops_rad"] = STOPS
            elif leads:
                arm |= {"follower": channel.replace("leader", "follower"), **leads}
            own[f"{channel.rpartition('_')[2]}_arm_config"] = arm
        if len(own) == 2:
            document[section] = {"type": f"bi_yam_{role}", **own}
        elif own:
            document[section] = {"type": f"yam_{role}", **next(iter(own.values()))}
    path = directory / "rig.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def mobile_rig_file(directory, rig, arms=(), **fields):
    """The file of a rig with a base, alone or with these two followers. `fields`: options of each part."""
    on_rig = {"interface": "yam_sim", "can_options": {"rig": rig.name}, **fields}
    base = {"channel": BASE_CHANNEL, **on_rig}
    robot = {"type": "yam_base", **base}
    if arms:
        own = {"gripper_stops_rad": STOPS, "gravity_factor": [1.0] * 6, **on_rig}
        sides = {f"{name.rpartition('_')[2]}_arm_config": {"channel": name, **own} for name in arms}
        robot = {"type": "yam_mobile", **sides, "base_config": base}
    path = directory / "rig.yaml"
    path.write_text(yaml.safe_dump({"robot": robot}))
    return path


class HostProcess:
    """yam-host on a rig's file; `address` is where it listens."""

    def __init__(self, file, directory, *options, port=None):
        self.address = HostAddress("127.0.0.1", port or free_port())
        self.log = directory / "host.txt"
        with open(self.log, "ab") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "lerobot_robot_yam.commands.servers.host", f"--config_path={file}"]
                + [f"--listen={self.address}", f"--keys={directory / 'keys'}", *options],
                cwd=ROOT,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=os.environ | {"HF_LEROBOT_CALIBRATION": str(directory / "cal")},
                start_new_session=True,
            )

    def wait(self):
        """Until it answers."""
        deadline = time.monotonic() + _START_S
        while True:
            assert self.process.poll() is None and time.monotonic() < deadline, self.said()
            with contextlib.suppress(LinkError):
                return hello(Host(self.address))

    def said(self):
        """What it has printed."""
        return self.log.read_text(errors="replace")[-4000:]

    def end(self):
        """End it; its arms land."""
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(90)
        (runtime_dir() / "host-address").unlink(missing_ok=True)  # of one that was killed


@contextlib.contextmanager
def running_host(file, directory, *options, port=None):
    """A host that answers, and has ended after the block."""
    host = HostProcess(file, directory, *options, port=port)
    try:
        host.wait()
        yield host
    finally:
        host.end()


class ServedArms:
    """A host in a thread of the tests, for arms of a live rig, or of one in lock-step (`link_in_step`).

    Args:
        rig: it.
        channels: of its arms; followers are the robot, leaders the teleoperator; "base" is the robot's base.
        keys, land_after_s: see `HostServer`.
        rail: of the base.
        fields: of each arm's config, see `sim_config`.
    """

    def __init__(self, rig, *channels, keys=None, land_after_s=30.0, rail=None, **fields):
        self.groups = []
        for role, kind in (("robot", "follower"), ("teleop", "leader")):
            arms = [sim_config(rig, channel, **fields) for channel in channels if channel.startswith(kind)]
            parts = dict(zip([""] if len(arms) == 1 else ["left_", "right_"], arms, strict=False))
            device = f"{'bi_' * (len(arms) == 2)}yam_{kind}"
            if role == "robot" and BASE_CHANNEL in channels:
                parts[BASE_PREFIX] = base_on(rig, rail=rail)
                device = "yam_mobile" if arms else "yam_base"
            if parts:
                options = {prefix: dataclasses.asdict(part) for prefix, part in parts.items()}
                first = sum(len(group.parts) for group in self.groups)
                self.groups.append(HostedGroup(role, device, parts, options, first, isolation_of(rig)))
        self.address = HostAddress("127.0.0.1", free_port())
        self.server = HostServer(HostSockets(self.address, keys), self.groups, land_after_s, lambda *_: None)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self.server.run, args=[self._end.is_set])

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()

    def session(self, group="robot", key=None, address=None):
        """A session of that group over a link, not yet started; its parts have their names of the host."""
        prefixes = next(tuple(found.prefixes) for found in self.groups if found.role == group)
        return self.session_at(address or self.address, prefixes, group, key)

    @staticmethod
    def session_at(address, prefixes, group="robot", key=None):
        """The same of any host."""
        device = HostedDevice(Host(address, key), group, prefixes)
        return ArmSession(configs_of(device), device.runner())


def configs_of(device):
    """Configurations of a hosted device's parts, as LeRobot's device of this computer makes them."""
    kinds = {BASE_PREFIX: BaseConfig}
    return [kinds.get(prefix, ArmConfig)(**options) for prefix, options in device.options.items()]
