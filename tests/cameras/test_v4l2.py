"""The ioctls of V4L2, against the header that they come from; files that are no V4L2 nodes."""

import errno
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from lerobot_robot_yam.cameras import v4l2
from lerobot_robot_yam.errors import CameraError

HEADER = Path("/usr/include/linux/videodev2.h")
REQUESTS = {
    "VIDIOC_ENUM_FMT": (v4l2.ENUM_FMT, "v4l2_fmtdesc", v4l2.FMT),
    "VIDIOC_ENUM_FRAMESIZES": (v4l2.ENUM_FRAMESIZES, "v4l2_frmsizeenum", v4l2.SIZE),
    "VIDIOC_ENUM_FRAMEINTERVALS": (v4l2.ENUM_FRAMEINTERVALS, "v4l2_frmivalenum", v4l2.INTERVAL),
    "VIDIOC_QUERYCTRL": (v4l2.QUERYCTRL, "v4l2_queryctrl", v4l2.QUERY),
    "VIDIOC_S_CTRL": (v4l2.S_CTRL, "v4l2_control", v4l2.CONTROL),
}
# What the kernel fills in, and what the struct of ours reads there.
FILLED = {
    "v4l2_fmtdesc": (v4l2.FMT, ".pixelformat = 7", lambda row: row[4] == 7),
    "v4l2_frmsizeenum": (v4l2.SIZE, ".type = 1, .discrete = {640, 480}", lambda row: row[2:] == (1, 640, 480)),
    "v4l2_frmivalenum": (v4l2.INTERVAL, ".type = 1, .discrete = {1, 30}", lambda row: row[4:] == (1, 1, 30)),
    "v4l2_queryctrl": (
        v4l2.QUERY,
        ".minimum = -1, .maximum = 9, .step = 2, .default_value = 5, .flags = 1",
        lambda row: row[3:] == (-1, 9, 2, 5, 1),
    ),
    "v4l2_control": (v4l2.CONTROL, ".id = 3, .value = -4", lambda row: row == (3, -4)),
}
CONTROLS = {
    "V4L2_CID_EXPOSURE_ABSOLUTE": v4l2.EXPOSURE,
    "V4L2_CID_GAIN": v4l2.GAIN,
    "V4L2_CID_WHITE_BALANCE_TEMPERATURE": v4l2.WHITE_BALANCE,
    "V4L2_CID_EXPOSURE_AUTO": v4l2.AUTO_EXPOSURE,
    "V4L2_CID_AUTO_WHITE_BALANCE": v4l2.AUTO_WHITE_BALANCE,
    "V4L2_EXPOSURE_MANUAL": v4l2.MANUAL,
}


@pytest.mark.skipif(shutil.which("cc") is None or not HEADER.exists(), reason="no C compiler, or no kernel headers")
def test_numbers_and_structs_are_those_of_the_header(tmp_path):
    lines = [f'printf("{name} %lu\\n", (unsigned long){name});' for name in (*REQUESTS, *CONTROLS)]
    lines += [
        f'{{ struct {name} x = {{{values}}}; printf("{name} "); for (size_t i = 0; i < sizeof x; i++) '
        f'printf("%02x", ((unsigned char *)&x)[i]); printf("\\n"); }}'
        for name, (_, values, _) in FILLED.items()
    ]
    source = tmp_path / "asked.c"
    source.write_text(f"#include <linux/videodev2.h>\n#include <stdio.h>\nint main(void) {{ {' '.join(lines)} }}\n")
    subprocess.run(["cc", str(source), "-o", str(tmp_path / "asked")], check=True)
    told = dict(re.findall(r"(\w+) (\w+)", subprocess.check_output([str(tmp_path / "asked")], text=True)))
    for name, (number, _, _) in REQUESTS.items():
        assert int(told[name]) == number, name
    for name, number in CONTROLS.items():
        assert int(told[name]) == number, name
    for name, (form, _, is_right) in FILLED.items():
        data = bytes.fromhex(told[name])
        assert len(data) == form.size and is_right(form.unpack(data)), name


def test_a_file_offers_nothing(tmp_path):
    (tmp_path / "video0").touch()
    assert v4l2.modes(tmp_path / "video0") == []
    assert v4l2.control_range(tmp_path / "video0", v4l2.GAIN) is None
    with pytest.raises(CameraError, match="does not take 3"):
        v4l2.set_control(tmp_path / "video0", v4l2.GAIN, 3)
    with pytest.raises(CameraError, match="cannot be opened: No such file"):
        v4l2.modes(tmp_path / "video1")


def test_a_cameras_modes(tmp_path, monkeypatch):
    """As a kernel answers for a camera with one format, one discrete size with two rates, and sizes in steps."""
    yuyv = int.from_bytes(b"YUYV", "little")
    rows = {
        v4l2.ENUM_FMT: [v4l2.FMT.pack(0, 1, 0, b"", yuyv)],
        v4l2.ENUM_FRAMESIZES: [v4l2.SIZE.pack(0, yuyv, 1, 640, 480), v4l2.SIZE.pack(1, yuyv, 3, 16, 16)],
        v4l2.ENUM_FRAMEINTERVALS: [
            v4l2.INTERVAL.pack(0, yuyv, 640, 480, 1, 1, 30),
            v4l2.INTERVAL.pack(1, yuyv, 640, 480, 1, 1, 15),
            v4l2.INTERVAL.pack(2, yuyv, 640, 480, 3, 1, 60),
        ],
    }

    def ioctl(_, request, buffer):
        index = int.from_bytes(buffer[:4], "little")
        if index >= len(rows[request]):
            raise OSError(errno.EINVAL, "Invalid argument")
        buffer[:] = rows[request][index]

    monkeypatch.setattr(v4l2.fcntl, "ioctl", ioctl)
    (tmp_path / "video0").touch()
    assert v4l2.modes(tmp_path / "video0") == [v4l2.Mode("YUYV", 640, 480, (15.0, 30.0))]


def test_a_mode_reads_well():
    assert str(v4l2.Mode("YUYV", 640, 480, (15.0, 30.0))) == "YUYV 640x480 at 15/30 fps"
