"""The emergency stop of everything that this user drives on this machine: latched by anybody, released on purpose.

A file is the latch: it outlives whoever made it, and looking whether it is there costs a loop 2 µs a tick.
"""

import json
import logging
import os
import time

from lerobot_robot_yam.runtime import runtime_dir

logger = logging.getLogger(__name__)


class EmergencyStop:
    """The latch. While it is set followers hold, leaders float, and no arm is energised.

    EmergencyStop().latch("somebody shouted")
    """

    def __init__(self) -> None:
        self._path = runtime_dir() / "emergency-stop"
        self._name = str(self._path)
        self._unwritten = False  # latched, with no way to write it down

    @property
    def latched(self) -> bool:
        """Whether the stop is set."""
        try:
            os.stat(self._name)
        except OSError:
            return self._unwritten
        return True

    def reason(self) -> str:
        """Who set it, when and why; empty when it is not set."""
        try:
            data = json.loads(self._path.read_text())
            return f"{data['why']} (process {data['pid']}, {data['at']})"
        except FileNotFoundError:
            return ""
        except (OSError, ValueError, KeyError, TypeError):
            return "unknown"

    def latch(self, why: str) -> None:
        """Stop everything, until `release`. The first reason stands.

        Raises:
            OSError: it cannot be written down, so nobody else hears of it. For this object it is latched for good.
        """
        if self.latched:
            return
        data = {"why": why, "pid": os.getpid(), "at": time.strftime("%Y-%m-%d %H:%M:%S")}
        self._unwritten = True
        self._path.write_text(json.dumps(data) + "\n")
        self._unwritten = False
        logger.error("emergency stop: %s; release it with `yam-estop release`", why)

    def release(self) -> None:
        """Let arms move again: each from where it is, with its next target."""
        self._path.unlink(missing_ok=True)
