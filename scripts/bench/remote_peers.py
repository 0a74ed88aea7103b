"""How others drive a robot on another computer, beside which scripts/bench_remote.py measures our link."""

import contextlib
import importlib
import json
import multiprocessing
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import zmq

RATE_HZ = 60.0  # of a client
_JOINTS = 7


def percentiles(seconds: list[float]) -> dict[str, float]:
    """In ms."""
    return {f"p{share}_ms": round(float(np.percentile(seconds, share)) * 1e3, 2) for share in (50, 99)}


def cpu_s(pid: int) -> float:
    """Time that all threads of a process have run until now: what the scheduler has counted."""
    return sum(int(path.read_text().split()[0]) for path in Path(f"/proc/{pid}/task").glob("*/schedstat")) / 1e9


def lekiwi(rate_hz: float, seconds: float, port: int) -> dict[str, Any]:
    """LeRobot's: what a client reads was sampled how long ago, and how long a command waits for the loop."""
    context = zmq.Context()
    sockets: dict[str, zmq.Socket[bytes]] = {}
    for name, kind, options in (
        ("take", zmq.PULL, {zmq.CONFLATE: 1}),
        ("tell", zmq.PUSH, {zmq.SNDHWM: 2}),
        ("command", zmq.PUSH, {zmq.CONFLATE: 1}),
        ("observe", zmq.PULL, {zmq.CONFLATE: 1}),
    ):
        sockets[name] = context.socket(kind)
        for option, value in (options | {zmq.LINGER: 0}).items():
            sockets[name].setsockopt(option, value)
    for name, end, at in (
        ("take", "bind", port),
        ("tell", "bind", port + 1),
        ("command", "connect", port),
        ("observe", "connect", port + 1),
    ):
        getattr(sockets[name], end)(f"tcp://127.0.0.1:{at}")
    keys = [f"{side}_joint_{n}.pos" for side in ("left", "right") for n in range(7)]
    latency: list[float] = []
    ages: list[float] = []
    ended = threading.Event()

    def host() -> None:
        while not ended.is_set():
            begin = time.monotonic()
            with contextlib.suppress(zmq.Again):
                latency.append(time.monotonic() - json.loads(sockets["take"].recv(zmq.NOBLOCK))["at"])
            with contextlib.suppress(zmq.Again):
                sockets["tell"].send(
                    json.dumps(dict.fromkeys(keys, 0.5) | {"at": time.monotonic()}).encode(), zmq.NOBLOCK
                )
            time.sleep(max(0.0, 1.0 / rate_hz - (time.monotonic() - begin)))

    thread = threading.Thread(target=host)
    thread.start()
    newest, begin = 0.0, time.monotonic()
    for number in range(int(seconds * RATE_HZ)):
        with contextlib.suppress(zmq.Again):
            newest = json.loads(sockets["observe"].recv(zmq.NOBLOCK))["at"]
        if newest:
            ages.append(time.monotonic() - newest)
        sockets["command"].send(json.dumps(dict.fromkeys(keys, 0.5) | {"at": time.monotonic()}).encode())
        time.sleep(max(0.0, begin + (number + 1) / RATE_HZ - time.monotonic()))
    ended.set()
    thread.join()
    context.destroy(linger=0)
    return {"age": percentiles(ages), "latency": percentiles(latency)}


def portal_calls(seconds: float, ports: list[int]) -> dict[str, Any]:
    """The vendor's: a server of calls for each arm, which a client calls; it waits for observations.

    Raises:
        ImportError: `portal` is not installed.
    """
    portal = importlib.import_module("portal")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=_serve_calls, args=(ports, theirs), daemon=True)
    server.start()
    ours.recv()
    clients = [portal.Client(f"127.0.0.1:{port}", logging=False) for port in ports]
    q = np.full(_JOINTS, 0.5)
    ages, waits = [], []
    begin, before = time.monotonic(), cpu_s(server.pid)
    for number in range(int(seconds * RATE_HZ)):
        asked = time.monotonic()
        sampled = min(float(client.get_observations().result()["at"]) for client in clients)
        now = time.monotonic()
        ages.append(now - sampled)
        waits.append(now - asked)
        for client in clients:
            client.command_joint_pos(q, time.monotonic())
        time.sleep(max(0.0, begin + (number + 1) / RATE_HZ - time.monotonic()))
    used = (cpu_s(server.pid) - before) / (time.monotonic() - begin)
    for client in clients:
        client.close()
    ours.send("end")
    latency = ours.recv()
    server.join()
    return {
        "age": percentiles(ages),
        "latency": percentiles(latency),
        "waits": percentiles(waits),
        "host_cpu": round(used, 4),
    }


def _serve_calls(ports: list[int], caller: Connection) -> None:
    portal = importlib.import_module("portal")
    latency: list[float] = []

    def observations() -> dict[str, Any]:
        values = {f"joint_{what}": np.full(_JOINTS, 0.5) for what in ("pos", "vel", "eff")}
        return values | {"at": time.monotonic()}

    def command(q: np.ndarray, at: float) -> None:
        latency.append(time.monotonic() - at)

    servers = [portal.Server(port, host="127.0.0.1", logging=False) for port in ports]
    for server in servers:
        server.bind("get_observations", observations)
        server.bind("command_joint_pos", command)
        server.start(block=False)
    caller.send("ready")
    caller.recv()
    caller.send(latency)
    for server in servers:
        server.close()
