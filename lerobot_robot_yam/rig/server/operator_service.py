"""The rig server's side of the scripted operator: a child process, which runs while the leaders are energised."""

import logging
import subprocess
import sys

from lerobot_robot_yam.rig.simulation.device import RigDevice

logger = logging.getLogger(__name__)

NO_OPERATOR = "none"
_SETTLE_S = 0.5  # from the leaders' torque to the operator's start
_END_TIMEOUT_S = 2.0


class OperatorService:
    """Starts the operator of a rig's scene when every leader motor is enabled, ends it when one is not."""

    def __init__(self, rig: str, device: RigDevice):
        self._rig, self._device = rig, device
        self._task = device.scene.options.operator
        self._process: subprocess.Popen[bytes] | None = None
        self._leaving: subprocess.Popen[bytes] | None = None  # told to end, not yet gone
        self._leaving_since_s = 0.0
        self._energised_s: float | None = None
        self._failed = False

    def keep(self, now_s: float) -> None:
        """Start or end the operator; call several times a second."""
        if self._task == NO_OPERATOR:
            return
        if self._leaving is not None:
            if self._leaving.poll() is not None:
                self._leaving = None
            elif now_s - self._leaving_since_s > _END_TIMEOUT_S:
                self._leaving.kill()
        if not self._device.leaders_energised():
            self._energised_s, self._failed = None, False
            if self._process is not None:
                # Without waiting: motors that are not answered for 0.1 s count as lost.
                self._process.terminate()
                self._leaving, self._leaving_since_s, self._process = self._process, now_s, None
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
