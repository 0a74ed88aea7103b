"""Child processes of the rig server: the renderer of the cameras, and the scripted operator.

The server never blocks on a child. It forwards hellos of kind "camera", and sends the results of `poll` to clients.
"""

import contextlib
import json
import logging
import math
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Collection, Hashable, Iterator, Mapping
from typing import Any

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.client.launch import MAX_PACKET, to_json
from lerobot_robot_yam.rig.client.rendered_camera import MAX_FPS, MAX_HEIGHT, MAX_WIDTH, Settings, frame_path
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.operation import number

logger = logging.getLogger(__name__)

NO_OPERATOR = "none"
_SETTLE_S = 0.5  # delay between energising the leaders and starting the operator, s
_END_TIMEOUT_S = 2.0
_DEAD = "camera {camera} has died: it delivers no more frames; check its cable, then connect again"


class CameraService:
    """All rendered cameras of one rig, rendered by one child process, which starts when the first camera is opened.

    cameras: names of the cameras in the scene. on_demand: whether the renderer renders only when `draw` is called.
    """

    def __init__(self, rig: str, cameras: Collection[str], on_demand: bool = False):
        self._rig = rig
        self._cameras = tuple(cameras)
        self._on_demand = on_demand
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None  # socket to the renderer process
        self._users: dict[Settings, set[Hashable]] = {}  # settings → clients; ready if in `_ready`
        self._opened: set[Settings] = set()  # all settings ever opened: their frame files outlive a crashed renderer
        self._ready: set[Settings] = set()
        self._answers: list[tuple[Hashable, dict[str, Any]]] = []
        self._stalls: dict[str, float] = {}  # camera → monotonic time of its next frame, s
        self._dead: set[str] = set()
        self.drawn = True

    def open(self, client: Hashable, hello: Mapping[str, Any]) -> dict[str, Any]:
        """Open a camera for a client; the first call starts the renderer.

        Returns:
            The reply to send immediately. A second reply ({"ready": true} or an error) comes from `poll`.

        Raises:
            ConfigError: the camera is unknown, or its settings are impossible.
            RigError: the camera is dead, see `fail`.
        """
        name = self._known(hello.get("camera"))
        if name in self._dead:
            raise RigError(_DEAD.format(camera=name))
        width, height, fps = (_whole(hello, key) for key in ("width", "height", "fps"))
        if not (16 <= width <= MAX_WIDTH and 16 <= height <= MAX_HEIGHT and 1 <= fps <= MAX_FPS):
            raise ConfigError(
                f"camera {name}: {width}x{height} at {fps} fps; possible are 16x16 to {MAX_WIDTH}x{MAX_HEIGHT} "
                f"and 1 to {MAX_FPS} fps"
            )
        settings = (name, width, height, fps)
        self._users.setdefault(settings, set()).add(client)
        self._opened.add(settings)
        if settings in self._ready:
            self._answers.append((client, {"ready": True}))
        else:
            if self._process is None:
                self._start()
            self._tell("open", camera=settings)
        return {"block": str(frame_path(self._rig, *settings))}

    def drop(self, client: Hashable) -> None:
        """Remove a client, and close cameras without clients. Unknown clients are ignored."""
        for settings in [settings for settings, users in self._users.items() if client in users]:
            self._users[settings].discard(client)
            if not self._users[settings]:
                del self._users[settings]
                self._ready.discard(settings)
                self._tell("close", camera=settings)

    def fail(self, camera: Any, kind: Any, seconds: Any = None) -> None:
        """Make a camera fail, see `RigOperations.camera_fault`.

        Raises:
            ConfigError: the camera or kind is unknown, or `seconds` is invalid or given for a kind other than "stall".
        """
        name = self._known(camera)
        if kind not in (None, "stall", "dead") or (seconds is not None and kind != "stall"):
            raise ConfigError(f"camera {name}: a fault is 'stall' (maybe with seconds), 'dead' or None, not {kind!r}")
        self._dead.discard(name)
        self._stalls.pop(name, None)
        if kind == "stall":
            self._stalls[name] = math.inf if seconds is None else time.monotonic() + number(seconds, 0.0)
        self._tell("stall", camera=name, until_s=self._stalls.get(name, 0.0))
        if kind != "dead":
            return
        self._dead.add(name)
        for settings in [settings for settings in self._users if settings[0] == name]:
            for client in list(self._users[settings]):
                self._answers.append((client, {"error": _DEAD.format(camera=name), "kind": "RigError"}))
                self.drop(client)

    def draw(self, anew: bool) -> None:
        """Request one image of each open camera from an on-demand renderer; `drawn` becomes True once all are rendered.

        anew: whether the world was restarted since the last image.
        """
        self.drawn = False
        self._tell("draw", anew=anew)

    def _known(self, name: Any) -> str:
        if name not in self._cameras:
            raise ConfigError(f"unknown camera {name!r}; the scene has: {', '.join(sorted(self._cameras))}")
        return str(name)

    def fileno(self) -> int | None:
        """Return the descriptor to watch for reading; None without renderer. Each renderer has a new descriptor."""
        return None if self._socket is None else self._socket.fileno()

    def poll(self) -> list[tuple[Hashable, dict[str, Any]]]:
        """Return new replies for clients: those of the renderer, or the error of its exit. Never blocks."""
        if self._socket is not None:
            with contextlib.suppress(BlockingIOError):
                while packet := _received(self._socket):
                    self._heard(json.loads(packet))
                self._died()
        answers, self._answers = self._answers, []
        return answers

    def close(self) -> None:
        process, self._process = self._process, None
        if self._socket is not None:
            self._socket.close()  # the renderer exits when its socket is closed
            self._socket = None
        if process is not None:
            _end(process)
            for settings in self._opened:
                frame_path(self._rig, *settings).unlink(missing_ok=True)

    def _start(self) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-P", "-m", "lerobot_robot_yam.rig.render.renderer", "--rig", self._rig]
        command += ["--requests-fd", str(theirs.fileno()), *["--on-demand"] * self._on_demand]
        with theirs:  # `give_way` needs a separate session
            self._process = subprocess.Popen(command, start_new_session=True, pass_fds=(theirs.fileno(),))
        for name, until_s in self._stalls.items():
            self._tell("stall", camera=name, until_s=until_s)

    def _tell(self, verb: str, **details: Any) -> None:
        if self._socket is not None:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # poll() reports the exit
                self._socket.send(to_json({"do": verb, **details}))

    def _heard(self, message: dict[str, Any]) -> None:
        if "drawn" in message:
            self.drawn = True
            return
        if "error" in message:
            self._fail_all(message["error"])
            return
        name, width, height, fps = message["ready"]
        settings = (name, width, height, fps)
        if settings in self._users and settings not in self._ready:
            self._ready.add(settings)
            self._answers += [(client, {"ready": True}) for client in self._users[settings]]

    def _died(self) -> None:
        assert self._process is not None
        code = self._process.wait()
        why = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        logger.error("the renderer ended (%s); its cameras deliver nothing until they are opened again", why)
        self._fail_all(f"the renderer of rig {self._rig} ended ({why}); see the rig's log")
        self.close()

    def _fail_all(self, error: str) -> None:
        """Send an error to all clients, and remove them."""
        failed = {"error": error, "kind": "RigError"}
        self._answers += [(client, failed) for client in set().union(*self._users.values())]
        self._users.clear()
        self._ready.clear()


class OperatorService:
    """Operator process of a rig's scene; runs while all leader motors are enabled."""

    def __init__(self, rig: str, device: RigDevice):
        self._rig, self._device = rig, device
        self._process: subprocess.Popen[bytes] | None = None
        self._now_s, self._steps = 0.0, self._run(device.scene.options.operator)

    def keep(self, now_s: float) -> None:
        """Start or end the operator as required; must be called several times per second."""
        self._now_s = now_s
        next(self._steps)

    def _run(self, task: str) -> Iterator[None]:
        """Yield instead of blocking: a server pause of 0.1 s would look like lost motors."""
        energised, events = self._device.leaders_energised, self._device.events
        while True:
            since_s = self._now_s
            while task == NO_OPERATOR or not energised() or self._now_s - since_s <= _SETTLE_S:
                since_s = self._now_s if not energised() else since_s
                yield
            command = [sys.executable, "-P", "-m", "lerobot_robot_yam.rig.operator.operator"]
            command += ["--rig", self._rig, "--task", task]
            process = self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
            events.add("operator_started", task=task)
            while energised() and process.poll() is None:
                yield
            if process.poll() is not None:
                logger.error("the operator ended with exit code %d", process.returncode)
                events.add("operator_ended", code=process.returncode)
                while energised():
                    yield
            process.terminate()
            terminated_s = self._now_s
            while process.poll() is None:
                if self._now_s - terminated_s > _END_TIMEOUT_S:
                    process.kill()
                yield
            self._process = None

    def close(self) -> None:
        if self._process is not None:
            self._process.terminate()
            _end(self._process)


def _received(renderer: socket.socket) -> bytes:
    """Return the next packet, empty at end of stream. Raises BlockingIOError: no packet has arrived."""
    try:
        return renderer.recv(MAX_PACKET, socket.MSG_DONTWAIT)
    except ConnectionResetError:  # raised once if the renderer exited with unread packets; its own packets follow
        return renderer.recv(MAX_PACKET, socket.MSG_DONTWAIT)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Wait for a terminated process, and kill it if it does not exit in time."""
    try:
        process.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _whole(hello: Mapping[str, Any], key: str) -> int:
    value = hello.get(key)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ConfigError(f"camera {hello.get('camera')}: {key} must be a whole number, not {value!r}")
    return value
