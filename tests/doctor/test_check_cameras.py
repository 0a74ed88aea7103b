"""Cameras and their USB links, on directory trees laid out as sysfs is."""

import sys

import pytest

from lerobot_robot_yam.cameras.video_devices import video_devices
from lerobot_robot_yam.doctor.check_cameras import check_cameras
from lerobot_robot_yam.doctor.kit.findings import Section, Severity
from tests.support.doctor_desk import Sysfs

WEBCAM = {"vendor": "046d", "product_id": "0825", "product": "Webcam C270"}


@pytest.fixture
def sysfs(tmp_path, monkeypatch):
    (tmp_path / "pyrealsense2.py").touch()  # as if it were installed
    monkeypatch.syspath_prepend(tmp_path)
    return Sysfs(tmp_path / "sys")


def check(sysfs, configured=None, dev=None):
    section = Section("cameras")
    check_cameras(video_devices(sysfs=sysfs.root), configured or {}, dev or sysfs.root / "dev", section)
    return section


def test_a_realsense_without_the_package_that_reads_it(sysfs, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)  # Python's mark of what is not there
    sysfs.realsense("video0", "2-1", "5000")
    assert check(sysfs).findings == []  # nobody wants it
    (problem,) = check(sysfs, {"top": {"type": "intelrealsense"}}).findings
    assert "pyrealsense2" in problem.what and ".[realsense]" in problem.remedy


def test_a_realsense_on_usb_3(sysfs):
    for number in range(6):  # depth, colour and their metadata
        sysfs.realsense(f"video{number}", "2-1", "5000") if number == 0 else sysfs.camera(
            f"video{number}",
            "2-1",
            "Intel(R) RealSense(TM) Depth Ca",
            function=f"1.{number}",
            vendor="8086",
            speed="5000",
            product="Intel(R) RealSense(TM) Depth Camera 405",
        )
    section = check(sysfs, {"top": {"type": "intelrealsense"}})
    assert section.findings == []
    (row,) = section.rows
    assert row["nodes"] == [f"video{number}" for number in range(6)]
    assert (row["speed_mbit"], row["bus"]) == (5000.0, 2)


def test_a_realsense_on_usb_2(sysfs):
    sysfs.realsense("video0", "1-3", "480")
    (problem,) = check(sysfs).findings
    assert problem.severity is Severity.PROBLEM
    assert "480 Mbit/s" in problem.what and "USB 3" in problem.remedy and "1-3" in problem.where


def test_a_realsense_whose_nodes_a_library_has_taken(sysfs):
    sysfs.usb("1-3", speed="480", vendor="8086", product="Intel(R) RealSense(TM) Depth Camera 435")
    (problem,) = check(sysfs).findings
    assert "RealSense" in problem.what


def test_two_cameras_on_one_usb_2_bus(sysfs):
    sysfs.camera("video0", "1-3", "C270", **WEBCAM)
    sysfs.camera("video2", "1-4", "C270", **WEBCAM)
    (warning,) = check(sysfs).findings
    assert warning.severity is Severity.WARNING
    assert "video0" in warning.what and "video2" in warning.what and "USB bus 1" in warning.where
    assert "another USB controller" in warning.remedy


def test_two_cameras_on_two_buses(sysfs):
    sysfs.camera("video0", "1-3", "C270", **WEBCAM)
    sysfs.camera("video2", "3-4", "C270", **WEBCAM)
    assert check(sysfs).findings == []


def test_configured_cameras(sysfs, tmp_path):
    dev = tmp_path / "dev"
    dev.mkdir()
    (dev / "video0").touch()
    configured = {
        "top": {"type": "intelrealsense", "serial_number_or_name": "1"},
        "wrist_left": {"type": "opencv", "index_or_path": "/dev/video0"},
        "wrist_right": {"type": "opencv", "index_or_path": 2},
        "sim": {"type": "yam_sim", "camera": "top"},
    }
    section = check(sysfs, configured, dev)
    by_place = {finding.where: finding for finding in section.findings}
    assert by_place["cameras top"].severity is Severity.PROBLEM
    assert by_place["camera wrist_right"].severity is Severity.PROBLEM
    assert by_place["camera wrist_left"].severity is Severity.NOTE and "by-path" in by_place["camera wrist_left"].remedy
    assert len(by_place) == 3


def test_a_yam_realsense(sysfs):
    configured = {"top": {"type": "yam_realsense", "serial_number_or_name": "1"}}
    sysfs.camera("video0", "1-3", "C270", serial="2", **WEBCAM)
    (problem,) = check(sysfs, configured).findings
    assert problem.where == "camera top" and "no camera 1" in problem.what and "yam-cameras list" in problem.remedy
    configured["top"]["serial_number_or_name"] = "2"
    assert check(sysfs, configured).findings == []
    sysfs.realsense("video2", "2-1", "5000")
    configured["top"]["serial_number_or_name"] = "the number on its label"
    assert check(sysfs, configured).findings == []


def test_a_camera_that_is_not_usb(sysfs):
    node = sysfs.root / "class/video4linux/video0"
    node.mkdir(parents=True)
    (node / "name").write_text("pispbe\n")
    section = check(sysfs)
    assert section.rows[0]["speed_mbit"] is None and section.findings == []
