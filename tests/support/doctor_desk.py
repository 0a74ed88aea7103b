"""What the doctor's tests share: the rig's channels, recorded tools, a made-up sysfs, running the command, its JSON."""

import dataclasses
import json
import os
import shutil
from pathlib import Path

from lerobot_robot_yam.commands.doctor import main
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.doctor.check_channel import examine_channel
from lerobot_robot_yam.doctor.kit.findings import as_json, empty_report, exit_status
from lerobot_robot_yam.doctor.kit.targets import from_option
from tests.support.paths import ROOT

RECORDED = ROOT / "tests" / "doctor" / "recorded"
RULE = 'SUBSYSTEM=="net", ACTION=="add", '


ARM = [MotorSpec(f"joint_{i + 1}", i + 1, kind) for i, kind in enumerate(["DM4340"] * 3 + ["DM4310"] * 3)]
MOTORS = [*ARM, MotorSpec("gripper", 7, "DM4310")]
FOLLOWER, LEADER = "follower_left", "leader_left"
LEADER_ARM = f"{LEADER}:yam:yam_teaching_handle"


def recorded(name, tool="ip"):
    return (RECORDED / f"{name}.{tool}.json").read_text()


def replay_tools(directory, monkeypatch, name, rename=None):
    """Put tools called `ip` and `tc` first in PATH that print a recording.

    `rename`: only these interfaces, under other names.
    """
    for tool, key in (("ip", "ifname"), ("tc", "dev")):
        rows = json.loads(recorded(name, tool))
        if rename is not None:
            rows = [{**row, key: rename[row[key]]} for row in rows if row.get(key) in rename]
        output = directory / f"{tool}.json"
        output.write_text(json.dumps(rows))
        script = directory / tool
        script.write_text(f"#!/bin/sh\ncat {output}\n")
        script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{directory}{os.pathsep}{os.environ['PATH']}")


def virtual(rig, *channels, samples=2):
    arguments = ["--interface=yam_sim", f"--rig={rig.name}", f"--samples={samples}"]
    return [*arguments, *(f"--channel={channel}" for channel in channels)]


def examine(capsys, *arguments):
    """Run the command; returns its exit status and its JSON object."""
    status = main([*arguments, "--json"])
    return status, json.loads(capsys.readouterr().out)


def examine_arm(rig, arm, samples=0):
    """What the command finds on a channel of a rig in lock-step, without all that it looks at besides.

    arm: NAME[:ARM[:GRIPPER]].
    """
    target = from_option(arm, "yam_lockstep", None)
    config = dataclasses.replace(target.config, can_options={"rig": rig.name})
    return examine_target(dataclasses.replace(target, config=config), samples)


def examine_target(target, samples=0):
    """The same of an arm of a run config."""
    report = empty_report()
    examine_channel(target, None, samples, report, lambda text: None)
    return exit_status(report), json.loads(as_json(report))


def found(report, severity, where, what=""):
    """The findings of that severity with these words."""
    return [f for f in report["findings"] if f["severity"] == severity and where in f["where"] and what in f["what"]]


class Sysfs:
    """A sysfs tree with USB devices, as the kernel lays it out: real directories below devices/, links elsewhere."""

    def __init__(self, root: Path, controller="devices/pci0000:00/0000:00:14.0"):
        self.root = root
        self.controller = controller
        (root / "class" / "net").mkdir(parents=True)

    def usb(self, port, *, speed="480", vendor="1d50", product_id="606f", product="canable gs_usb", serial=None):
        """Directory of the USB device at `port`, such as "1-2.3"."""
        bus = port.partition("-")[0]
        device = self.root / self.controller / f"usb{bus}" / port
        device.mkdir(parents=True, exist_ok=True)
        values = {"busnum": bus, "speed": speed, "idVendor": vendor, "idProduct": product_id, "product": product}
        for name, value in (values | ({"serial": serial} if serial else {})).items():
            (device / name).write_text(f"{value}\n")
        bus_list = self.root / "bus/usb/devices"
        bus_list.mkdir(parents=True, exist_ok=True)
        if not (bus_list / port).exists():
            (bus_list / port).symlink_to(device)
        return device

    def adapter(self, name, port, *, number="0x0", dev_port="0", function="1.0", kernel_driver="gs_usb", **usb):
        """A CAN interface on a USB adapter."""
        function = self.usb(port, **usb) / f"{port}:{function}"
        interface = function / "net" / name
        interface.mkdir(parents=True)
        driver = self.root / "bus/usb/drivers" / kernel_driver
        driver.mkdir(parents=True, exist_ok=True)
        if not (function / "driver").exists():
            (function / "driver").symlink_to(driver)
        (interface / "device").symlink_to(function)
        (interface / "type").write_text("280\n")
        (interface / "dev_id").write_text(f"{number}\n")
        (interface / "dev_port").write_text(f"{dev_port}\n")
        (self.root / "class/net" / name).symlink_to(interface)

    def unplug(self, port):
        """Take the adapter at a USB port out."""
        for link in (self.root / "class/net").iterdir():
            if f"/{port}/" in str(link.resolve()):
                link.unlink()
        (self.root / "bus/usb/devices" / port).unlink()
        shutil.rmtree(self.usb(port))

    def camera(self, node, port, name, *, function="1.0", **usb):
        """A video node of a USB camera."""
        directory = self.usb(port, **usb) / f"{port}:{function}"
        video = directory / "video4linux" / node
        video.mkdir(parents=True)
        (video / "device").symlink_to(directory)
        (video / "name").write_text(f"{name}\n")
        (self.root / "class/video4linux").mkdir(parents=True, exist_ok=True)
        (self.root / "class/video4linux" / node).symlink_to(video)

    def realsense(self, node, port, speed):
        """A RealSense D405 on a link of that speed."""
        name = "Intel(R) RealSense(TM) Depth Camera 405  Intel(R) RealSense(TM) Depth Camera 405"
        usb = {"speed": speed, "vendor": "8086", "product_id": "0b5b", "product": name.partition("  ")[0]}
        self.camera(node, port, name[:31], serial="123422070577", **usb)
