"""The soak's yam-host: it has the arms, and the devices reach them over a link, on one machine."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import yaml

from lerobot_robot_yam.errors import LinkError
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host, hello
from soak.devices import follower_options, leader_options

_START_S, _END_S = 30.0, 90.0
_LAND_AFTER_S = 2.0  # after a link process was killed; a person waits longer


@contextlib.contextmanager
def hosting(rig: str, folder: Path, coupled: bool) -> Iterator[tuple[str, int]]:
    """A host of all four arms: its address and process number. It has landed them after the block.

    Raises:
        LinkError: it does not come up.
    """
    sections = {}
    for section, role, options in (
        ("robot", "follower", follower_options(rig)),
        ("teleop", "leader", leader_options(rig, coupled)),
    ):
        left, right = options
        arms = {"left_arm_config": left, "right_arm_config": right}
        sections[section] = {"type": f"bi_yam_{role}", "id": "soak", **arms}
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(sections))
    address = HostAddress("127.0.0.1", _free_port())
    command = ["-m", "lerobot_robot_yam.commands.servers.host", f"--config_path={path}", f"--listen={address}"]
    process = subprocess.Popen(
        [sys.executable, *command, f"--keys={folder / 'keys'}", f"--land_after_s={_LAND_AFTER_S}"],
        env=os.environ | {"HF_LEROBOT_CALIBRATION": str(folder / "calibration")},
    )
    try:
        deadline = time.monotonic() + _START_S
        while True:
            try:
                hello(Host(address))
                break
            except LinkError:
                if process.poll() is not None or time.monotonic() > deadline:
                    raise
        yield str(address), process.pid
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(_END_S)


def _free_port() -> int:
    """The next one is nearly always free, too."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])
