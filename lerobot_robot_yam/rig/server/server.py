"""Process of the virtual rig: sockets and physics in one thread.

    python -m lerobot_robot_yam.rig.server.server --name NAME [--scene SCENE] [--options JSON]

`launch` starts this process. The server wakes up for packets and for physics, steps the world up to the present and
answers each packet immediately with one packet. A rig ends about a second after its last client has disconnected.

The first packet of a client is its hello: {"kind": "bus", "channel": ...}, {"kind": "control"} or
{"kind": "camera", ...}. A client whose hello has `"hold": false` does not keep the rig alive.
"""

import argparse
import contextlib
import dataclasses
import functools
import gc
import json
import logging
import os
import select
import signal
import socket
import time
from collections.abc import Mapping
from typing import Any

import mujoco

from lerobot_robot_yam.errors import BusError, ConfigError, RigError, YamError
from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.bus.link_state import LinkState, LinkTable
from lerobot_robot_yam.rig.client import launch
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.server.child_processes import CameraService, OperatorService
from lerobot_robot_yam.rig.server.lifetime import Lifetime
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.rig_operations import perform
from lerobot_robot_yam.rig.world.world import WorldBlock
from lerobot_robot_yam.system.realtime import request_realtime

logger = logging.getLogger(__name__)

PRIORITY = 10  # real-time priority, below that of the control loops
_BATCH_S = 0.004  # maximum delay of a physics step without packets, s
_PUBLISH_S = 1 / 60
_HOUSE_S = 0.05
_MALFORMED = (ValueError, KeyError, TypeError, AttributeError, YamError)  # raised by malformed requests and hellos


class Client:
    """A connection; `channel` is set by the hello of a bus client."""

    def __init__(self, sock: socket.socket):
        self.socket = sock
        self.kind, self.holds = "", False
        self.channel: Channel | None = None
        self.hands: set[str] = set()  # leaders whose hand this client moves


class RigServer:
    """Sockets, lifetime and child processes of one rig.

    owner: id of the process with which the rig ends, None for a named rig.
    """

    def __init__(self, name: str, device: RigDevice, owner: int | None):
        self.name, self.device = name, device
        self._clients: dict[int, Client] = {}
        self._wakes = 0
        self._started_s = time.monotonic()
        self._lifetime = Lifetime(name, owner, self._started_s)
        self._ending = False
        self._poll = select.epoll()
        self._path = launch.rig_path(name, "sock")
        self._path.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(self._path))
        self._listener.listen(64)
        self._listener.setblocking(False)
        self._poll.register(self._listener.fileno(), select.EPOLLIN)
        self._block = WorldBlock(launch.rig_path(name, "world"), device.world)
        self._links = LinkTable(launch.rig_path(name, "links"), len(device.channels))
        self._link_numbers = {channel: index for index, channel in enumerate(device.channels)}
        for channel, index in self._link_numbers.items():
            device.channels[channel].link.publish = functools.partial(self._links.write, index)
        self._cameras = CameraService(name, [camera.name for camera in device.scene.cameras])
        self._operator = OperatorService(name, device)
        self.realtime = ""
        device.operations |= {"stats": self._stats, "end": self.stop, "camera_fault": self._camera_fault}

    def run(self) -> None:
        """Serve until the rig is no longer needed."""
        device, world = self.device, self.device.world
        now = time.monotonic()
        world.start(now)
        next_publish = next_house = now
        while not self._ending:
            ready = self._poll.poll(max(0.0, min(_BATCH_S, device.due_s - time.monotonic())))
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
                self._block.publish(world)
            if now >= next_house:
                next_house = now + _HOUSE_S
                self._keep_house(now)

    def close(self) -> None:
        """Remove the rig's files, drop the clients, end the children; after a crash a new rig may start meanwhile."""
        self._path.unlink(missing_ok=True)
        self._links.close()
        for suffix in ("scene", "log"):
            launch.rig_path(self.name, suffix).unlink(missing_ok=True)
        self._listener.close()
        for client in list(self._clients.values()):
            self._drop(client)
        self._operator.close()
        self._cameras.close()
        self._block.close()
        self._poll.close()
        self._lifetime.close()

    def stop(self) -> None:
        """Make `run` return at the next opportunity."""
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
        """Read all packets of a client; queued packets of frames are handled as one packet."""
        frames, gone = b"", False
        try:
            while packet := client.socket.recv(launch.MAX_PACKET):
                if client.channel is not None:
                    frames += packet
                    if len(packet) == client.channel.tick_size:
                        break
                elif not client.kind:
                    self._hello(client, packet)
                else:
                    self._answer(client, self._ask(client, packet))
            else:
                gone = True
        except BlockingIOError:
            pass
        except OSError as error:
            logger.info("a client is dropped: %s", error)
            gone = True
        if frames and client.channel is not None:
            try:
                client.channel.receive_packet(client.socket, frames, time.monotonic())
            except YamError as error:
                logger.info("a client is dropped: %s", error)
                gone = True
        if gone:
            self._drop(client)

    def _hello(self, client: Client, packet: bytes) -> None:
        self._lifetime.met_a_client()
        try:
            hello = json.loads(packet)
            client.kind = hello["kind"]
            client.holds = bool(hello.get("hold", True))
            scene = self.device.scene
            reply: dict[str, Any] = {"pid": os.getpid(), "scene": scene.name}
            reply["options"] = dataclasses.asdict(scene.options)
            if client.kind == "bus":
                channel = self._channel(str(hello["channel"]))
                reply |= {"link": self._link_numbers[channel.name], "unplugs": channel.link.unplugs}
                client.channel = channel
            elif client.kind == "camera":
                reply |= self._cameras.open(client, hello)
            elif client.kind != "control":
                raise ConfigError(f"a rig has no clients of kind {client.kind!r}")
        except (*_MALFORMED, RecursionError) as error:
            client.holds = False
            self._answer(client, launch.error_reply(error))
            return
        self._answer(client, reply)  # sent before the client joins the channel, whose frames must follow the reply
        if client.channel is not None:
            client.channel.clients.append(client.socket)
            self.device.events.add("bus_opened", channel=client.channel.name)

    def _channel(self, name: str) -> Channel:
        if name not in self.device.channels:
            raise BusError(launch.no_channel(self.name, name, self.device.channels))
        channel = self.device.channels[name]
        if channel.link.state == LinkState.GONE:
            raise BusError(f"{name}: no such device; is its CAN adapter plugged in?")
        return channel

    def _ask(self, client: Client, packet: bytes) -> dict[str, Any]:
        try:
            request = json.loads(packet)
            reply = perform(self.device, request)
            if request["op"] in ("hand", "release"):
                (client.hands.add if request["op"] == "hand" else client.hands.discard)(request["channel"])
            return reply
        except (*_MALFORMED, IndexError, ArithmeticError, RuntimeError) as error:
            return launch.error_reply(error)

    def _camera_fault(self, camera: str, kind: str | None, seconds: float | None) -> None:
        self._cameras.fail(camera, kind, seconds)
        self.device.events.add("camera_fault", camera=camera, fault=kind, seconds=seconds)

    def _answer(self, client: Client, reply: Mapping[str, Any]) -> None:
        try:
            client.socket.send(launch.to_json(reply))
        except BlockingIOError:
            logger.warning("a client does not read its answers")
        except OSError:
            pass  # the client has disconnected, which epoll reports

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--name", required=True, help="the rig's name")
    parser.add_argument("--scene", help="scene name or YAML path")
    parser.add_argument("--options", type=json.loads, default={}, help="options of the scene, as JSON")
    parser.add_argument("--owner", type=int, help="end with this process")
    parser.add_argument("--ready-fd", type=int, help="socket for one packet of JSON once up")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")
    mujoco.set_mju_user_warning(lambda text: logger.warning("MuJoCo: %s", text))  # by default MuJoCo writes a file
    gc.disable()  # while the objects are built that `request_realtime` freezes
    try:
        device = RigDevice(load_scene(args.scene, args.options))
        server = RigServer(args.name, device, args.owner)
        launch.tell_scene(args.name, args.scene, args.options)
    except Exception as error:
        known = error if isinstance(error, YamError) else RigError(f"rig {args.name} crashed at its start: {error!r}")
        _report(args.ready_fd, launch.error_reply(known))
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
        os.rename(launch.rig_path(args.name, "log"), launch.rig_path(args.name, "crash"))
        raise
    finally:
        server.close()


def _report(fd: int | None, message: dict[str, Any]) -> None:
    if fd is not None:
        with socket.socket(fileno=fd) as starter:
            starter.send(launch.to_json(message))


if __name__ == "__main__":
    main()
