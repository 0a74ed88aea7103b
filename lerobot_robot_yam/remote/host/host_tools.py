"""Commands of this computer that a client may have run here, because they only look: yam-doctor, yam-identify."""

import contextlib
import logging
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path

from lerobot_robot_yam.errors import ConfigError, LifeCycleError
from lerobot_robot_yam.remote.host.hosted_group import Reply

logger = logging.getLogger(__name__)

_DOCTOR, _IDENTIFY = "doctor", "identify"
_TIMEOUT_S = 120.0
_MOST_TEXT = 200_000  # of its output that travels


class HostTools:
    """Runs one at a time.

    Args:
        rig_file: of this host's arms; None: there is none, and nothing can be asked.
        channels: of CAN, which may be identified, with what names each on a command line.
    """

    def __init__(self, rig_file: Path | None, channels: Mapping[str, str]):
        self._rig_file, self._channels = rig_file, channels
        self._running: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None

    def run(self, tool: str, channel: str, as_json: bool, reply: Reply) -> None:
        """Start one; the answer comes with its end.

        Args:
            tool: "doctor" or "identify".
            channel: that is identified.
            as_json: whether it answers in JSON.
            reply: gets its exit status and what it has printed.

        Raises:
            ConfigError: no such tool or channel.
            LifeCycleError: one runs.
        """
        if tool == _DOCTOR and self._rig_file is not None:
            arguments = ["lerobot_robot_yam.commands.doctor", f"--config_path={self._rig_file}"]
        elif tool == _IDENTIFY and channel in self._channels:
            arguments = ["lerobot_robot_yam.commands.identify", *shlex.split(self._channels[channel])]
        else:
            raise ConfigError(f"the host has no {tool} {channel}; its channels are {', '.join(self._channels)}")
        if self._thread is not None and self._thread.is_alive():
            raise LifeCycleError("the host still looks at its arms for somebody; try again in a moment")
        command = [sys.executable, "-m", *arguments, *(["--json"] if as_json else [])]
        self._thread = threading.Thread(target=self._run, args=(command, reply), name="yam-tool", daemon=False)
        self._thread.start()

    def _run(self, command: list[str], reply: Reply) -> None:
        pipe, null = subprocess.PIPE, subprocess.DEVNULL
        logger.info("runs %s for a client", " ".join(command[2:]))
        self._running = subprocess.Popen(command, stdin=null, stdout=pipe, stderr=pipe, text=True, errors="replace")
        try:
            said, complained = self._running.communicate(timeout=_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._running.kill()
            said, complained = self._running.communicate()
        status = self._running.returncode
        reply({"status": status, "out": said[:_MOST_TEXT], "err": complained[:_MOST_TEXT]})

    def close(self) -> None:
        """End it. Idempotent."""
        if self._thread is not None:
            if self._running is not None:
                with contextlib.suppress(OSError):
                    self._running.send_signal(signal.SIGINT)  # it removes its lock
            self._thread.join()
