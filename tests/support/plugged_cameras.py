"""Cameras without hardware: a tree of sysfs and /dev whose video node OpenCV reads, fed with JPEGs at a camera's pace.

The node is a pipe: OpenCV's own reader opens and decodes it. So a camera can stall (nothing is written), be pulled out
(the pipe ends, its files go) and come back, under another number if asked.
"""

import contextlib
import os
import shutil
import threading
import time

import cv2
import numpy as np

from tests.support.doctor_desk import Sysfs

SERIAL = "841113021535"
# FFmpeg else collects seconds of pictures before it gives the first.
READ_AT_ONCE = {"OPENCV_FFMPEG_CAPTURE_OPTIONS": "probesize;32|analyzeduration;0"}
_COMMENT = b"\xff\xfe" + (8192).to_bytes(2) + bytes(8190)  # FFmpeg reads whole blocks
WIDTH, HEIGHT, FPS = 64, 48, 30


class Tree:
    """Files of a computer below `root`: sys and dev."""

    def __init__(self, root):
        self.root = root
        self.sysfs = Sysfs(root / "sys")
        (root / "dev/v4l/by-id").mkdir(parents=True)
        (root / "dev/v4l/by-path").mkdir()

    def webcam(self, node, port, serial="200901010001", product="Webcam C270"):
        """A camera with a node, links, and an empty file in its place."""
        self._add(node, port, product, serial, vendor="046d", product_id="0825", product=product)

    def realsense(self, node, port, serial=SERIAL, number="405", speed="5000"):
        """A RealSense D405, or of another number."""
        product = f"Intel(R) RealSense(TM) Depth Camera {number}"
        self._add(node, port, product[:31], serial, vendor="8086", product_id="0b5b", speed=speed, product=product)

    def _add(self, node, port, name, serial, **usb):
        self.sysfs.camera(node, port, name, serial=serial, **usb)
        (self.root / "dev" / node).touch()
        link = f"usb-{usb['product'].replace(' ', '_')}_{serial}-video-index0"
        for kind, name in (("by-id", link), ("by-path", f"pci-0000:00:14.0-usb-0:{port}:1.0-video-index0")):
            with contextlib.suppress(FileExistsError):  # by-id, of a serial number that two share
                (self.root / "dev/v4l" / kind / name).symlink_to(f"../../{node}")

    def unplug(self, node, port):
        """Take a camera out."""
        for link in self.root.glob("dev/v4l/*/*"):
            if os.readlink(link).endswith(f"/{node}"):
                link.unlink()
        (self.root / "dev" / node).unlink()
        (self.root / "sys/class/video4linux" / node).unlink()
        (self.root / "sys/bus/usb/devices" / port).unlink()
        shutil.rmtree(self.sysfs.usb(port))
        with contextlib.suppress(FileNotFoundError):
            (self.root / "sys/bus/usb/devices" / port).unlink()  # `usb` has made it again


class FedCamera:
    """A RealSense whose pictures a thread writes. The red of a picture is its number.

    Args:
        tree: where it is plugged in.
    """

    def __init__(self, tree, width=WIDTH, height=HEIGHT, fps=FPS):
        self.tree, self._size, self._fps = tree, (width, height), fps
        self.number = 0
        self.stalls = False
        self._node, self._thread = "", None
        self._ended = threading.Event()

    def plug_in(self, node="video0", port="2-1"):
        """It is there, and gives pictures once somebody reads."""
        self._node, self._port = node, port
        self.tree.realsense(node, port)
        path = self.tree.root / "dev" / node
        path.unlink()
        os.mkfifo(path)
        self._ended.clear()
        self._thread = threading.Thread(target=self._feed, args=(path,))
        self._thread.start()

    def pull_out(self):
        """It is gone."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._ended.set()
            thread.join()
            self.tree.unplug(self._node, self._port)

    def _feed(self, path):
        while not self._ended.is_set():
            try:
                pipe = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
            except OSError:  # nobody reads
                time.sleep(0.005)
                continue
            os.set_blocking(pipe, True)
            with contextlib.suppress(BrokenPipeError), open(pipe, "wb", buffering=0) as file:
                while not self._ended.wait(1 / self._fps):
                    if not self.stalls:
                        file.write(self._next())

    def _next(self):
        self.number += 1
        width, height = self._size
        picture = np.full((height, width, 3), (40, 90, 2 * self.number % 256), np.uint8)  # BGR
        jpeg = cv2.imencode(".jpg", picture)[1].tobytes()
        return jpeg[:-2] + _COMMENT + jpeg[-2:]
