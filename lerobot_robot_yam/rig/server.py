"""The virtual rig's process: sockets outside, physics inside, one thread.

    python -m lerobot_robot_yam.rig.server --name NAME [--scene SCENE] [--set key=value ...]

Started by `launch`. It wakes for packets and for physics, steps the world up to now and answers each packet at once
as one packet. It ends about a second after its last client has left. Its first packet from a client says who it is:
{"kind": "bus", "channel": ...}, {"kind": "control"} or {"kind": "camera", ...}; `"hold": false` keeps the client
from keeping the rig alive.
"""

import argparse
import contextlib
import gc
import json
import logging
import os
import select
import signal
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import BusError, ConfigError, RigError, YamError
from lerobot_robot_yam.realtime import request_realtime
from lerobot_robot_yam.rig import commands, wire
from lerobot_robot_yam.rig.camera_service import CameraService
from lerobot_robot_yam.rig.channel import Channel
from lerobot_robot_yam.rig.device import RigDevice
from lerobot_robot_yam.rig.launch import MAX_PACKET, error_reply, rig_path
from lerobot_robot_yam.rig.lifetime import Lifetime
from lerobot_robot_yam.rig.operator_service import OperatorService
from lerobot_robot_yam.rig.scene import load_scene
from lerobot_robot_yam.shared_block import SharedBlock

logger = logging.getLogger(__name__)

PRIORITY = 10  # below the control loops, above everything ordinary
_BATCH_S = 0.004  # physics between two packets waits for at most this long
_PUBLISH_S = 1 / 60
_HOUSE_S = 0.05


class Client:
    """A connection; `channel` is set once it has introduced itself as a bus client."""

    def __init__(self, sock: socket.socket):
        self.socket = sock
        self.kind = ""
        self.holds = False
        self.channel: Channel | None = None
        self.hands: set[str] = set()  # leaders whose hand this client moves


class RigServer:
    """Sockets, life time and children of one rig.

    Args:
        name: the rig's name.
        device: what is simulated.
        arguments: --scene and --set, for the renderer.
        owner: process whose end is the rig's end.
    """

    def __init__(self, name: str, device: RigDevice, arguments: list[str], owner: int | None):
        self.name, self.device = name, device
        self._clients: dict[int, Client] = {}
        self._wakes = 0
        self._started_s = time.monotonic()
        self._lifetime = Lifetime(name, owner, self._started_s)
        self._ending = False
        self._poll = select.epoll()
        self._path = rig_path(name, "sock")
        self._path.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(self._path))
        self._listener.listen(64)
        self._listener.setblocking(False)
        self._poll.register(self._listener.fileno(), select.EPOLLIN)
        self._block = SharedBlock(rig_path(name, "world"), device.world.state_dtype(), create=True)
        self._record = np.zeros((), device.world.state_dtype())
        self._cameras = CameraService(name, [camera.name for camera in device.scene.cameras], arguments)
        self._operator = OperatorService(name, device)
        self.realtime = ""

    def run(self) -> None:
        """Serve until the rig is no longer needed."""
        device, world = self.device, self.device.world
        now = time.monotonic()
        world.start(now)
        next_publish = next_house = now
        while not self._ending:
            ready = self._poll.poll(_BATCH_S)
            self._wakes += 1
            now = time.monotonic()
            device.advance(now)
            for fd, _ in ready:
                client = self._clients.get(fd)
                if client is not None:
                    self._hear(client)
                elif fd == self._listener.fileno():
                    self._accept()
            if now >= next_publish:
                next_publish = max(next_publish + _PUBLISH_S, now)
                self._publish()
            if now >= next_house:
                next_house = now + _HOUSE_S
                self._keep_house(now)

    def close(self) -> None:
        """End the children, drop the clients, remove the rig's files."""
        self._listener.close()
        for client in list(self._clients.values()):
            self._drop(client)
        self._operator.close()
        self._cameras.close()
        self._path.unlink(missing_ok=True)
        self._block.close()
        self.device.events.close()
        self._poll.close()
        rig_path(self.name, "log").unlink(missing_ok=True)
        self._lifetime.close()

    def stop(self) -> None:
        """Leave `run` at the next opportunity."""
        self._lifetime.end()

    # clients

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                sock, _ = self._listener.accept()
                sock.setblocking(False)
                self._clients[sock.fileno()] = Client(sock)
                self._poll.register(sock.fileno(), select.EPOLLIN)

    def _hear(self, client: Client) -> None:
        """Take everything a client has sent; what has queued up counts as sent in one go."""
        frames: list[wire.Frame] = []
        gone = False
        try:
            while True:
                packet = client.socket.recv(MAX_PACKET)
                if not packet:
                    gone = True
                    break
                if client.channel is not None:
                    frames += wire.unpack(packet)
                elif not client.kind:
                    self._hello(client, packet)
                else:
                    self._answer(client, self._ask(client, packet))
        except BlockingIOError:
            pass
        except (OSError, YamError) as error:
            logger.info("a client is dropped: %s", error)
            gone = True
        if frames and client.channel is not None:
            client.channel.receive(client.socket, frames, time.monotonic())
        if gone:
            self._drop(client)

    def _hello(self, client: Client, packet: bytes) -> None:
        self._lifetime.met_a_client()
        try:
            hello = json.loads(packet)
            client.kind = hello["kind"]
            client.holds = bool(hello.get("hold", True))
            reply: dict[str, Any] = {"pid": os.getpid()}
            if client.kind == "bus":
                client.channel = self._channel(str(hello["channel"]))
            elif client.kind == "camera":
                reply |= self._cameras.open(client, hello)
            elif client.kind != "control":
                raise ConfigError(f"a rig has no clients of kind {client.kind!r}")
        except (ValueError, KeyError, TypeError, YamError) as error:
            client.holds = False
            self._answer(client, error_reply(error))
            return
        self._answer(client, reply)  # before the channel: its frames come after the answer
        if client.channel is not None:
            client.channel.clients.append(client.socket)
            self.device.events.add("bus_opened", channel=client.channel.name)

    def _channel(self, name: str) -> Channel:
        if name not in self.device.channels:
            raise BusError(f"rig {self.name} has no channel '{name}'; it has {', '.join(self.device.channels)}")
        return self.device.channels[name]

    def _ask(self, client: Client, packet: bytes) -> dict[str, Any]:
        try:
            request = json.loads(packet)
            if request.get("op") == "stats":
                return self._stats()
            if request.get("op") == "end":
                self.stop()
                return {}
            if request.get("op") == "hand":
                client.hands.add(request.get("channel"))
            return commands.ask(self.device, request)
        except (ValueError, KeyError, TypeError, AttributeError, IndexError, YamError) as error:
            return error_reply(error)

    def _answer(self, client: Client, reply: Mapping[str, Any]) -> None:
        try:
            client.socket.send(json.dumps(reply, default=_plain).encode())
        except BlockingIOError:
            logger.warning("a client does not read its answers")
        except OSError:
            pass  # it has gone; epoll tells

    def _drop(self, client: Client) -> None:
        fd = client.socket.fileno()
        if self._clients.pop(fd, None) is None:
            return
        self._poll.unregister(fd)
        if client.kind == "camera":
            self._cameras.drop(client)
        if client.channel is not None and client.socket in client.channel.clients:
            client.channel.clients.remove(client.socket)
            self.device.events.add("bus_closed", channel=client.channel.name)
        for channel in client.hands & self.device.hands.keys():
            self.device.hands[channel].release()
        client.socket.close()

    # periodic work

    def _publish(self) -> None:
        world, record = self.device.world, self._record
        record["sim_s"], record["stamp_s"] = world.sim_s, world.stamp_s
        record["qpos"], record["qvel"] = world.data.qpos, world.data.qvel
        self._block.write(record)

    def _keep_house(self, now_s: float) -> None:
        for client, reply in self._cameras.poll():
            if isinstance(client, Client) and client.socket.fileno() in self._clients:
                self._answer(client, reply)
        self._operator.keep(now_s)
        held = any(client.holds for client in self._clients.values())
        self._ending = self._lifetime.is_over(held, now_s, lambda: bool(self._poll.poll(0)))

    def _stats(self) -> dict[str, Any]:
        world = self.device.world
        return {
            "pid": os.getpid(),
            "sim_s": world.sim_s,
            "uptime_s": time.monotonic() - self._started_s,
            "cpu_s": time.process_time(),
            "slips": world.slips,
            "wakes": self._wakes,
            "realtime": self.realtime,
            "clients": len(self._clients),
            "frames": {name: channel.wire.frames for name, channel in self.device.channels.items()},
            "overflows": {name: channel.overflows for name, channel in self.device.channels.items()},
        }


def _plain(value: Any) -> Any:
    """JSON form of numpy values."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")


def _option(text: str) -> tuple[str, Any]:
    key, separator, value = text.partition("=")
    if not separator:
        raise ConfigError(f"--set takes key=value, not {text!r}")
    try:
        return key, json.loads(value)
    except json.JSONDecodeError:
        return key, value


def main() -> None:
    """Entry point of the server process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--name", required=True, help="the rig's name")
    parser.add_argument("--scene", help="scene name or YAML path")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="replace a scene option")
    parser.add_argument("--owner", type=int, help="end with this process")
    parser.add_argument("--ready-fd", type=int, help="write one JSON line here once up")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")
    mujoco.set_mju_user_warning(lambda text: logger.warning("MuJoCo: %s", text))  # else a file where we stand
    gc.disable()  # until everything is built; request_realtime freezes it
    arguments = ["--scene", args.scene] if args.scene else []
    for item in args.set:
        arguments += ["--set", item]
    try:
        device = RigDevice(load_scene(args.scene, dict(_option(item) for item in args.set)))
        if device.scene.options.event_dir is not None:
            folder = Path(device.scene.options.event_dir).expanduser()
            device.events.keep(folder / rig_path(args.name, "events.jsonl").name)
        server = RigServer(args.name, device, arguments, args.owner)
    except Exception as error:
        known = error if isinstance(error, YamError) else RigError(f"rig {args.name} crashed at its start: {error!r}")
        _report(args.ready_fd, error_reply(known))
        raise
    signal.signal(signal.SIGTERM, lambda *_: server.stop())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.enable()
    server.realtime = request_realtime(PRIORITY)
    logger.info("rig %s, pid %d, scene %s: %s", args.name, os.getpid(), device.scene.name, server.realtime)
    _report(args.ready_fd, {"pid": os.getpid()})
    try:
        server.run()
    except BaseException:
        logger.exception("rig %s crashed", args.name)
        os.rename(rig_path(args.name, "log"), rig_path(args.name, "crash"))
        raise
    finally:
        server.close()


def _report(fd: int | None, message: dict[str, Any]) -> None:
    if fd is not None:
        os.write(fd, json.dumps(message).encode() + b"\n")
        os.close(fd)


if __name__ == "__main__":
    main()
