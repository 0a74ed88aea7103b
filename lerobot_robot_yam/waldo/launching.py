"""Start and end of a controller from Commander's process, which forks workers at the same time.

`subprocess.Popen` waits for the end of a pipe that such a worker may keep open for ever; `posix_spawn` does not.
"""

import dataclasses
import json
import os
import signal
import socket
import sys
import time

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.session.runners import LAND_TIMEOUT_S
from lerobot_robot_yam.waldo.arm_choice import ArmChoice
from lerobot_robot_yam.waldo.wire import ANSWER_S, ask_once

_MODULE = "lerobot_robot_yam.waldo.controller.controller_process"
_LOOK_S = 0.05
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def serves(host: str, port: int) -> bool:
    """Return whether the port is taken."""
    try:
        socket.create_connection((host, port), ANSWER_S).close()
    except OSError:
        return False
    return True


class LaunchedController:
    """A controller that this process has started. It ends with this process, and lands the arm then.

    Args:
        host, port: address that it serves.
        choice: the arm's.
        channel: the real arm's, which is not energised by this; empty for the simulated arm only.
        timeout_s: longest wait for its answer.

    Raises:
        ControllerError: the port is taken, or the controller did not come up.
    """

    def __init__(self, host: str, port: int, choice: ArmChoice, channel: str, timeout_s: float):
        if serves(host, port):
            raise ControllerError(f"somebody serves {host}:{port} already; end that, or choose another port")
        self._owner = os.getpid()
        arguments = ["--host", host, "--port", str(port), "--parent", str(self._owner)]
        if channel:
            config = ArmConfig(channel=channel, name=channel, arm=choice.arm, gripper=choice.gripper)
            arguments += ["--arm-config", json.dumps(dataclasses.asdict(config))]
        self._pid: int | None = os.posix_spawn(
            sys.executable,
            [sys.executable, "-P", "-m", _MODULE, *arguments],
            {**os.environ, **choice.environment()},
            file_actions=[
                (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
                (os.POSIX_SPAWN_DUP2, 2, 1),
            ],
            setsid=True,
            setsigmask=[],
            setsigdef=_SIGNALS,
        )
        deadline = time.monotonic() + timeout_s
        while (ask_once(host, port, "ping") or {}).get("pid") != self._pid:
            if self._ended():
                raise ControllerError(f"the controller for {host}:{port} ended at its start; see its message above")
            if time.monotonic() > deadline:
                self.stop()
                raise ControllerError(f"the controller for {host}:{port} did not come up within {timeout_s:g} s")
            time.sleep(_LOOK_S)

    def _ended(self) -> bool:
        if self._pid is None:
            return True
        try:
            ended = os.waitpid(self._pid, os.WNOHANG)[0] == self._pid
        except ChildProcessError:  # the host has reaped it
            ended = True
        if ended:
            self._pid = None
        return ended

    def stop(self) -> None:
        """End the controller, after it has landed the arm. Idempotent; does nothing in a forked child."""
        if os.getpid() != self._owner or self._ended():
            return
        assert self._pid is not None
        os.kill(self._pid, signal.SIGTERM)
        deadline = time.monotonic() + LAND_TIMEOUT_S
        while not self._ended():
            if time.monotonic() > deadline:
                raise ControllerError("the arm is not down yet; its controller goes on landing it by itself")
            time.sleep(_LOOK_S)
