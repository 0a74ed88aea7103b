"""Formats, sizes, rates and controls of a V4L2 node, read with the ioctls of linux/videodev2.h.

OpenCV reads images, but neither formats nor control ranges. (linuxpy reads both, but is licensed under the GPL.)
"""

import errno
import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import CameraError

# Request numbers, structs and their fields from linux/videodev2.h, for 64-bit computers in native byte order.
ENUM_FMT, FMT = 0xC0405602, struct.Struct("=III32sI16x")  # index, type, flags, description, fourcc
ENUM_FRAMESIZES, SIZE = 0xC02C564A, struct.Struct("=IIIII16x8x")  # index, fourcc, type, width, height
ENUM_FRAMEINTERVALS, INTERVAL = 0xC034564B, struct.Struct("=IIIIIII16x8x")  # …, width, height, type, rate
QUERYCTRL, QUERY = 0xC0445624, struct.Struct("=II32siiiiI8x")  # id, type, name, min, max, step, default, flags
S_CTRL, CONTROL = 0xC008561C, struct.Struct("=Ii")  # id, value
_CAPTURE, _DISCRETE = 1, 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_FRMSIZE_TYPE_DISCRETE
_DISABLED = 0x1
_NO_ANSWER = (errno.EINVAL, errno.ENOTTY, errno.ERANGE, errno.EACCES, errno.EBUSY)

# V4L2 control ids; the unit of exposure is 100 µs.
EXPOSURE, GAIN, WHITE_BALANCE = 0x9A0902, 0x980913, 0x98091A
AUTO_EXPOSURE, AUTO_WHITE_BALANCE = 0x9A0901, 0x98090C
MANUAL, OFF = 1, 0  # values of AUTO_EXPOSURE and AUTO_WHITE_BALANCE


@dataclass(frozen=True)
class Mode:
    """Image format and size: `fourcc` such as "YUYV", width and height in pixels, and frames per second."""

    fourcc: str
    width: int
    height: int
    rates: tuple[float, ...]

    def __str__(self) -> str:
        return f"{self.fourcc} {self.width}x{self.height} at {'/'.join(f'{rate:g}' for rate in self.rates)} fps"


def modes(node: Path) -> list[Mode]:
    """List a node's formats with discrete sizes; empty if the node is not a V4L2 capture node.

    Raises:
        CameraError: the node cannot be opened.
    """
    found = []
    with _opened(node) as device:
        for *_, fourcc in _enumerated(device, ENUM_FMT, FMT, _CAPTURE, 0, b"", 0):
            name = fourcc.to_bytes(4, "little").decode("ascii", "replace")
            for _, _, kind, width, height in _enumerated(device, ENUM_FRAMESIZES, SIZE, fourcc, 0, 0, 0):
                if kind == _DISCRETE:
                    found.append(Mode(name, width, height, _rates(device, fourcc, width, height)))
    return found


def control_range(node: Path, number: int) -> tuple[int, int] | None:
    """Return minimum and maximum of a node's control, in the control's unit; None if the node lacks the control.

    Raises:
        CameraError: the node cannot be opened.
    """
    with _opened(node) as device:
        answer = _ask(device, QUERYCTRL, QUERY, number, 0, b"", 0, 0, 0, 0, 0)
    return None if answer is None or answer[-1] & _DISABLED else (answer[3], answer[4])


def set_control(node: Path, number: int, value: int) -> None:
    """Set a control to a value. Raises CameraError: the camera does not accept the value."""
    with _opened(node) as device:
        if _ask(device, S_CTRL, CONTROL, number, value) is None:
            raise CameraError(f"{node} does not take {value} for its control {number:#x}")


def _rates(device: int, fourcc: int, width: int, height: int) -> tuple[float, ...]:
    answers = _enumerated(device, ENUM_FRAMEINTERVALS, INTERVAL, fourcc, width, height, 0, 0, 0)
    found = [(above, below) for *_, kind, above, below in answers if kind == _DISCRETE and above]
    return tuple(sorted(round(below / above, 2) for above, below in found))


def _enumerated(device: int, request: int, form: struct.Struct, *values: Any) -> Iterator[tuple[Any, ...]]:
    """Yield the results of an ioctl whose request begins with an index, for increasing indices."""
    for index in count():
        answer = _ask(device, request, form, index, *values)
        if answer is None:
            return
        yield answer


def _ask(device: int, request: int, form: struct.Struct, *values: Any) -> tuple[Any, ...] | None:
    """Run an ioctl and return the result; None if the device does not support the request, or has no more entries."""
    buffer = bytearray(form.pack(*values))
    try:
        fcntl.ioctl(device, request, buffer)
    except OSError as error:
        if error.errno in _NO_ANSWER:
            return None
        raise CameraError(f"the camera does not answer: {error.strerror}") from error
    return form.unpack(buffer)


@contextmanager
def _opened(node: Path) -> Iterator[int]:
    try:
        device = os.open(node, os.O_RDWR | os.O_NONBLOCK)
    except OSError as error:
        raise CameraError(f"{node} cannot be opened: {error.strerror}") from error
    try:
        yield device
    finally:
        os.close(device)
