"""The caller's side: start the control loop of a robot, read states, give targets, stop safely."""

import dataclasses
import json
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Literal

from lerobot_robot_yam import errors
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.hardware import Hardware
from lerobot_robot_yam.arm.lifecycle import Mode
from lerobot_robot_yam.arm.port import ArmPort
from lerobot_robot_yam.arm.state import channel_key
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, YamError
from lerobot_robot_yam.runtime import rig_name

logger = logging.getLogger(__name__)

Isolation = Literal["process", "thread"]

_START_TIMEOUT_S = 60.0  # a virtual rig may have to start; a gripper calibration takes some seconds
_LAND_TIMEOUT_S = 60.0  # the longest way down at landing speed, and one retry


class ArmSession:
    """All arms of one robot or teleoperator, driven by one control loop.

        session = ArmSession([ArmConfig(name="left", channel="can_follower_l"), …])
        session.start()
        session["left"].observe()
        session.stop()

    Args:
        configs: the arms; names and channels must differ, rates must agree.
        isolation: "process" (the loop cannot be disturbed by the caller's interpreter) or "thread" (for debugging).

    Raises:
        ConfigError: the configurations cannot be used together.
    """

    def __init__(self, configs: Sequence[ArmConfig], isolation: Isolation = "process"):
        if isolation not in ("process", "thread"):
            raise ConfigError(f"isolation is 'process' or 'thread', not {isolation!r}")
        names = [config.name for config in configs]
        channels = [(config.interface, config.channel) for config in configs]
        if not configs or len(set(names)) < len(names) or len(set(channels)) < len(channels):
            raise ConfigError(f"arms of one robot need different names and channels, got {names} on {channels}")
        if len({config.rate_hz for config in configs}) > 1:
            raise ConfigError("arms of one robot tick together: give them the same rate_hz")
        self._isolation = isolation
        self._configs: list[ArmConfig] = []
        self._keys: list[str] = []
        for config in configs:
            rig = None
            if config.interface == "yam_sim":
                # The loop's process must meet the rig of this process, not start one of its own.
                rig, _ = rig_name(config.can_options.get("rig"))
                config = dataclasses.replace(config, can_options={**config.can_options, "rig": rig})
            self._configs.append(config)
            self._keys.append(channel_key(config.interface, config.channel, rig))
        self._hardware = {config.name: Hardware(config) for config in self._configs}
        self._ports: dict[str, ArmPort] = {}
        self._runner: _Process | _Thread | None = None

    def __getitem__(self, name: str) -> ArmPort:
        """Port of the arm called `name`.

        Raises:
            LifeCycleError: the session is not running.
            ConfigError: there is no such arm.
        """
        if name not in self._hardware:
            raise ConfigError(f"no arm is called {name!r}; there are {list(self._hardware)}")
        if name not in self._ports:
            raise LifeCycleError(f"{name}: not connected")
        return self._ports[name]

    def hardware(self, name: str) -> Hardware:
        """Profiles and limits of the arm called `name`."""
        return self._hardware[name]

    @property
    def running(self) -> bool:
        """True between `start` and `stop`, whatever state the arms are in."""
        return self._runner is not None

    @property
    def rig(self) -> str | None:
        """Name of the virtual rig, None on real arms."""
        return self._configs[0].can_options.get("rig") if self._configs[0].interface == "yam_sim" else None

    def start(self, search_grippers: bool = True) -> None:
        """Bring all arms up; returns when they hold (or float) and their grippers' stops are known.

        Args:
            search_grippers: False when `calibrate_gripper` follows anyway.

        Raises:
            YamError: what failed; nothing is energised and nothing is left behind.
        """
        if self._runner is not None:
            raise LifeCycleError("this session is running already")
        ports = {
            config.name: ArmPort(config, self._hardware[config.name], key)
            for config, key in zip(self._configs, self._keys, strict=True)
        }
        configs = [
            dataclasses.replace(config, gripper_search=config.gripper_search and search_grippers)
            for config in self._configs
        ]
        runner = (_Process if self._isolation == "process" else _Thread)(configs, self._keys)
        try:
            runner.start()
            for port in ports.values():
                port.attach()
        except BaseException:
            runner.stop()
            for port in ports.values():
                port.close()
            raise
        self._ports, self._runner = ports, runner

    def stop(self) -> None:
        """Land every arm, cut torque, end the loop. Idempotent; Ctrl-C does not hurry it."""
        runner, self._runner = self._runner, None
        if runner is None:
            return
        try:
            if runner.stop():  # then a stand-by may have taken over
                _wait_patiently(lambda: all(port.done or port.orphaned for port in self._ports.values()))
        finally:
            ports, self._ports = self._ports, {}
            for port in ports.values():
                port.close()

    def rearm(self) -> None:
        """Enable again what has failed, and let all arms of the session take targets again.

        Raises:
            LifeCycleError: an arm still fails, or needs a new connection.
        """
        for port in self._ports.values():
            port.rearm()

    def land(self) -> None:
        """Land every arm and wait until torque is off; the session still has to be stopped."""
        for port in self._ports.values():
            port.land()
        deadline = time.monotonic() + _LAND_TIMEOUT_S
        while any(port.mode() is not Mode.OFF for port in self._ports.values()):
            if time.monotonic() > deadline:
                raise LifeCycleError("an arm does not land; see the log for what is in its way")
            time.sleep(0.02)


class _Process:
    """The loop in a process of its own."""

    def __init__(self, configs: list[ArmConfig], keys: list[str]):
        self._configs, self._keys = configs, keys
        self._child: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._child = child = subprocess.Popen(
            [sys.executable, "-m", "lerobot_robot_yam.arm.process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        job = {
            "arms": [dataclasses.asdict(config) for config in self._configs],
            "keys": self._keys,
            "parent_pid": os.getpid(),
        }
        assert child.stdin is not None and child.stdout is not None
        child.stdin.write(json.dumps(job).encode() + b"\n")
        child.stdin.close()
        if not select.select([child.stdout], [], [], _START_TIMEOUT_S)[0]:
            raise YamError(f"the control process did not come up within {_START_TIMEOUT_S:.0f} s")
        line = child.stdout.readline()
        if not line:
            raise YamError(f"the control process died while starting (exit status {child.wait()}); see its log above")
        reply = json.loads(line)
        if "error" in reply:
            raise getattr(errors, reply["kind"], YamError)(reply["error"])

    def stop(self) -> bool:
        """Have it land and end; True when it has ended."""
        child, self._child = self._child, None
        if child is None:
            return True
        if child.poll() is None:
            child.send_signal(signal.SIGTERM)
        ended = _wait_patiently(lambda: child.poll() is not None)
        if child.stdout is not None:
            child.stdout.close()
        return ended


class _Thread:
    """The loop in a thread of the caller."""

    def __init__(self, configs: list[ArmConfig], keys: list[str]):
        self._land = threading.Event()
        self._settled = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, args=(configs, keys), name="yam-control", daemon=False)

    def _run(self, configs: list[ArmConfig], keys: list[str]) -> None:
        from lerobot_robot_yam.arm.process import control

        try:
            main = threading.main_thread()
            control(
                configs,
                keys,
                self._settled.set,
                lambda: self._land.is_set() or not main.is_alive(),
                realtime=False,
            )
        except BaseException as error:
            self._error = error
            if self._settled.is_set():
                logger.exception("control loop failed")
        finally:
            self._settled.set()

    def start(self) -> None:
        self._thread.start()
        if not self._settled.wait(_START_TIMEOUT_S):
            raise YamError(f"the control loop did not come up within {_START_TIMEOUT_S:.0f} s")
        if self._error is not None:
            raise self._error

    def stop(self) -> bool:
        """Have it land and end; True when it has ended."""
        self._land.set()
        return self._thread.ident is None or _wait_patiently(lambda: not self._thread.is_alive())


def _wait_patiently(done: Callable[[], bool]) -> bool:
    """Wait for a landing. Ctrl-C is answered with a word: the loop lands on its own, hurrying would drop an arm."""
    deadline = time.monotonic() + _LAND_TIMEOUT_S
    while True:
        try:
            while not done():
                if time.monotonic() > deadline:
                    logger.error("the arms are not down yet; their control loop goes on holding and landing by itself")
                    return False
                time.sleep(0.01)
            return True
        except KeyboardInterrupt:
            logger.warning("landing; the arms have no brakes, so this cannot be cut short")
