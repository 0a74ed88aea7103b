"""Commands of this computer that a client may have run here, because they only look: yam-doctor, yam-identify."""

import logging
import shlex
import subprocess
import sys
from collections.abc import Hashable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError, LifeCycleError

logger = logging.getLogger(__name__)

_TIMEOUT_S = 120.0
_MOST_BYTES = 200_000  # of its output that travels


class HostTools:
    """Runs one at a time.

    Args:
        rig_file: the file of this host's arms.
        channels: CAN channels which may be identified, with what names each on a command line.
    """

    def __init__(self, rig_file: Path, channels: Mapping[str, str]):
        self._rig_file, self._channels = rig_file, channels
        self._thread = ThreadPoolExecutor(1, "yam-tool")
        self._running: Future[subprocess.CompletedProcess[bytes]] | None = None
        self._asked: Hashable = None

    def run(self, asked: Hashable, tool: str, channel: str, as_json: bool) -> dict[str, Any] | None:
        """Run one; its exit status and what it has printed, None while it runs.

        Args:
            asked: tells the question from others. It is asked again until the tool has ended.
            tool: "doctor" or "identify".
            channel: the channel that is identified.
            as_json: whether it answers in JSON.

        Raises:
            ConfigError: no such channel.
            LifeCycleError: another one runs, or this one takes too long.
        """
        if self._running is None or asked != self._asked:
            if self._running is not None and not self._running.done():
                raise LifeCycleError("the host still looks at its arms for somebody; try again in a moment")
            command = self._command(tool, channel, as_json)
            logger.info("runs %s for a client", " ".join(command[2:]))
            self._asked = asked
            self._running = self._thread.submit(
                subprocess.run, command, stdin=subprocess.DEVNULL, capture_output=True, timeout=_TIMEOUT_S
            )
        if not self._running.done():
            return None
        try:
            done = self._running.result()
        except subprocess.TimeoutExpired as error:
            raise LifeCycleError(f"{tool} does not end on the host; it was ended after {_TIMEOUT_S:g} s") from error
        out, complaints = (said[:_MOST_BYTES].decode(errors="replace") for said in (done.stdout, done.stderr))
        return {"status": done.returncode, "out": out, "err": complaints}

    def _command(self, tool: str, channel: str, as_json: bool) -> list[str]:
        if tool == "doctor":
            arguments = ["lerobot_robot_yam.commands.doctor", f"--config_path={self._rig_file}"]
        elif tool == "identify" and channel in self._channels:
            arguments = ["lerobot_robot_yam.commands.identify", *shlex.split(self._channels[channel])]
        else:
            raise ConfigError(f"the host has no {tool} {channel}; its channels are {', '.join(self._channels)}")
        return [sys.executable, "-m", *arguments, *(["--json"] if as_json else [])]

    def close(self) -> None:
        """Wait for its end. Idempotent."""
        self._thread.shutdown()
