"""The rig server's side of the scripted operator: a child process, there while the leaders are energised."""

import logging
import subprocess
import sys

from lerobot_robot_yam.rig.simulation.device import RigDevice

logger = logging.getLogger(__name__)

NO_OPERATOR = "none"
_SETTLE_S = 0.5  # leaders must have been energised for so long
_END_TIMEOUT_S = 2.0


class OperatorService:
    """Starts the scene's operator when every leader motor is enabled, ends it when one is not.

    Args:
        rig: the rig's name.
        device: the rig.
    """

    def __init__(self, rig: str, device: RigDevice):
        self._rig, self._device = rig, device
        self._task = device.scene.options.operator
        self._process: subprocess.Popen[bytes] | None = None
        self._leaving: subprocess.Popen[bytes] | None = None  # told to end, not yet gone
        self._leaving_since_s = 0.0
        self._energised_s: float | None = None
        self._failed = False

    def keep(self, now_s: float) -> None:
        """Look after the operator; call several times a second."""
        if self._task == NO_OPERATOR:
            return
        self._see_off(now_s)
        if not self._device.leaders_energised():
            self._energised_s = None
            self._failed = False
            self._dismiss(now_s)
            return
        self._energised_s = self._energised_s or now_s
        if self._process is not None:
            code = self._process.poll()
            if code is not None:
                logger.error("the operator ended with exit code %d", code)
                self._device.events.add("operator_ended", code=code)
                self._process, self._failed = None, True
        elif not self._failed and self._leaving is None and now_s - self._energised_s > _SETTLE_S:
            command = [sys.executable, "-P", "-m", "lerobot_robot_yam.rig.operator.operator"]
            command += ["--rig", self._rig, "--task", self._task]
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
            self._device.events.add("operator_started", task=self._task)

    def _dismiss(self, now_s: float) -> None:
        """Tell the operator to end, without waiting: motors that are not answered for 0.1 s count as lost."""
        if self._process is not None:
            self._process.terminate()
            self._leaving, self._leaving_since_s, self._process = self._process, now_s, None

    def _see_off(self, now_s: float) -> None:
        if self._leaving is None:
            return
        if self._leaving.poll() is not None:
            self._leaving = None
        elif now_s - self._leaving_since_s > _END_TIMEOUT_S:
            self._leaving.kill()

    def close(self) -> None:
        """End the operator and wait for it: the rig is ending."""
        for process in (self._process, self._leaving):
            if process is None:
                continue
            process.terminate()
            try:
                process.wait(_END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._process = self._leaving = None
