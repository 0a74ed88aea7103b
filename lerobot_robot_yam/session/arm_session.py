"""Session of the arms of one robot: starts the control loop, reads states, writes targets, stops safely."""

import contextlib
import dataclasses
import logging
import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

from lerobot_robot_yam.arm.config import VIRTUAL, ArmConfig, check_together
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, YamError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.mobile.robot_parts import Part, resolve
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.base_client import BaseClient
from lerobot_robot_yam.session.runners import LAND_TIMEOUT_S, ProcessRunner, Runner, StepRunner, ThreadRunner
from lerobot_robot_yam.session.uncopyable import Uncopied
from lerobot_robot_yam.state.about import forget_about
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import channel_key, lock_path, state_path
from lerobot_robot_yam.system.clock import SYSTEM, Clock
from lerobot_robot_yam.system.runtime_files import FileLock, rig_name

logger = logging.getLogger(__name__)

MakeRunner = Callable[[list[Part], list[str]], Runner]
Isolation = Literal["process", "thread", "lockstep"] | MakeRunner
_IN_TROUBLE = (Mode.FAULT, Mode.LAND, Mode.OFF)  # modes that require re-arming before the other arms
_RUNNERS: dict[str, MakeRunner] = {
    "process": ProcessRunner,
    "thread": ThreadRunner,
    "lockstep": StepRunner,
}


class ArmSession(Uncopied):
    """All arms of one robot or teleoperator, driven by one control loop.

        session = ArmSession([ArmConfig(name="left", channel="can_follower_l"), …])
        session.start()
        session["left"].observe()
        session.stop()

    Args:
        configs: the arms; names and channels must differ, rates must be equal.
        isolation: "process" (the caller's interpreter cannot disturb the loop), "thread" (for debugging),
            "lockstep" (the loop ticks while the caller sleeps on `clock`; only for a rig in lock-step), or a
            function that creates another `Runner`.

    Raises:
        ConfigError: the configurations contradict each other.
    """

    def __init__(self, configs: Sequence[ArmConfig | BaseConfig], isolation: Isolation = "process"):
        if not callable(isolation) and isolation not in _RUNNERS:
            raise ConfigError(f"isolation is one of {', '.join(_RUNNERS)}, not {isolation!r}")
        check_together(configs)
        self._make_runner = isolation if callable(isolation) else _RUNNERS[isolation]
        self._parts: dict[str, Part] = {}
        self._keys: list[str] = []
        for config in configs:
            rig = config.can_options.get("rig")
            if config.interface == VIRTUAL:
                # Resolve the name in this process, so that the loop's process uses the same rig.
                rig, _ = rig_name(rig)
                config = dataclasses.replace(config, can_options={**config.can_options, "rig": rig})
            self._parts[config.name] = resolve(config)
            self._keys.append(channel_key(config.interface, config.channel, rig))
        self._clients: dict[str, ArmClient | BaseClient] = {}
        self._runner: Runner | None = None
        self._starting: Runner | None = None  # runner while the arms are being brought up
        self._pid = 0  # id of the process that started the session

    def __getitem__(self, name: str) -> ArmClient:
        """Return the client of the arm called `name`.

        Raises:
            LifeCycleError: the session is not running.
            ConfigError: there is no such arm.
        """
        client = self._client(name)
        if not isinstance(client, ArmClient):
            raise ConfigError(f"{name!r} is no arm but a base")
        return client

    def base(self, name: str) -> BaseClient:
        """Return the client of the base called `name`. Raises YamError: see `__getitem__`."""
        client = self._client(name)
        if not isinstance(client, BaseClient):
            raise ConfigError(f"{name!r} is no base but an arm")
        return client

    @property
    def bases(self) -> list[BaseClient]:
        """Clients of all bases; empty while the session is not running."""
        return [client for client in self._clients.values() if isinstance(client, BaseClient)]

    def _client(self, name: str) -> ArmClient | BaseClient:
        if name not in self._parts:
            raise ConfigError(f"no arm is called {name!r}; there are {list(self._parts)}")
        if name not in self._clients:
            raise LifeCycleError(f"{name}: not connected")
        return self._clients[name]

    def key(self, name: str) -> str:
        """Return the channel key of the arm called `name`. Other programs find the arm's state by this key."""
        return self._keys[list(self._parts).index(name)]

    def hardware(self, name: str) -> ResolvedArm:
        """Return the profiles and limits of the arm called `name`."""
        part = self._parts[name]
        assert isinstance(part, ResolvedArm)
        return part

    @property
    def running(self) -> bool:
        """True between `start` and `stop`, in whatever mode the arms are."""
        return self._runner is not None

    def start(self, search_grippers: bool = True) -> None:
        """Bring all arms up. Return when they hold (or float) and their grippers' stops are known.

        Args:
            search_grippers: whether to search for the stops. False also ignores stored stops that do not fit, for a
                following `calibrate_gripper`.

        Raises:
            YamError: bring-up failed; no arm is energised and all resources are released.
        """
        if self._runner is not None:
            raise LifeCycleError("this session is running already")
        parts = list(self._parts.values())
        if not search_grippers:
            parts = [part.without_search() if isinstance(part, ResolvedArm) else part for part in parts]
        runner = self._starting = self._make_runner(parts, self._keys)
        self._pid = os.getpid()
        clients: dict[str, ArmClient | BaseClient] = {}
        try:
            for number, (name, part) in enumerate(self._parts.items()):
                make = BaseClient if isinstance(part, ResolvedBase) else ArmClient
                clients[name] = make(part, runner.clock, partial(runner.note_written, number))  # type: ignore[arg-type]
            runner.start([client.descriptors for client in clients.values()])
        except BaseException:
            runner.stop()
            for client in clients.values():
                client.close()
            self._starting = None
            raise
        self._clients, self._runner, self._starting = clients, runner, None

    @property
    def clock(self) -> Clock:
        """Clock of the control loop."""
        return SYSTEM if self._runner is None else self._runner.clock

    def begin_stop(self) -> None:
        """Start landing every arm, without waiting. The caller has to call `stop` afterwards.

        A `start` that waits in another thread fails, or ends with landing arms.
        """
        runner = self._runner or self._starting
        if runner is not None and not self._forked:
            runner.land()

    def stop(self) -> bool:
        """Land every arm, cut torque, end the loop. Idempotent; Ctrl-C does not shorten the landing.

        In a forked child only the child's blocks are closed; the parent keeps driving the arms.

        Returns:
            Whether the arms are no longer driven. False: the arms are still in the air because the emergency stop is
            latched or an obstacle blocks them; they land later.
        """
        runner, self._runner = self._runner, None
        if runner is None:
            return True
        clients = list(self._clients.values())
        try:
            if self._forked:
                return False
            ended = runner.stop(lambda: all(client.off for client in clients))
            if ended:
                for client, key in zip(clients, self._keys, strict=True):
                    if not client.off:
                        _bury(client.config, key)
            return ended
        finally:
            self._let_go()

    @property
    def _forked(self) -> bool:
        return os.getpid() != self._pid

    def _let_go(self) -> None:
        clients, self._clients = self._clients, {}
        for client in clients.values():
            client.close()

    def discard(self) -> None:
        """End the session of a simulated lock-step world without landing. Idempotent.

        Raises:
            LifeCycleError: these arms are not in lock-step, so they have to land.
        """
        if self._runner is None:
            return
        if not isinstance(self._runner, StepRunner):
            raise LifeCycleError("only arms in lock-step can be discarded; stop the session, so that the arms land")
        if not self._forked:
            self._runner.discard()
        self._runner = None
        self._let_go()

    def rearm(self) -> None:
        """Re-enable motors after a fault, and make all arms of the session accept targets again.

        Wait for the search for a gripper's stops: a motor that lost power has lost its count of turns.

        Raises:
            LifeCycleError: an arm is still in fault or has to be connected again; its peers keep holding.
            MotorError: a gripper's stops are not found.
        """
        in_trouble = [client for client in self._clients.values() if client.mode() in _IN_TROUBLE]
        for client in (*in_trouble, *self._clients.values()):  # arms that only hold because of a peer come last
            client.rearm()
        for client in self._clients.values():
            client.await_gripper()

    def land(self) -> None:
        """Land every arm and wait until torque is cut. The session still has to be stopped.

        Raises:
            LifeCycleError: an arm does not land, or is in fault while the emergency stop is latched; the others land.
        """
        refused: list[YamError] = []
        for client in self._clients.values():
            try:
                client.land()
            except YamError as error:
                refused.append(error)
        if refused:
            raise refused[0]
        clock = self.clock
        deadline = clock.now() + LAND_TIMEOUT_S
        while any(client.mode() is not Mode.OFF for client in self._clients.values()):
            if clock.now() > deadline:
                raise LifeCycleError("an arm does not land; see the log for what is in its way")
            clock.sleep(0.02)


def _bury(config: ArmConfig | BaseConfig, key: str) -> None:
    """Log that an arm's control process and stand-by have both died, and remove the files of both."""
    logger.critical("%s: nothing drives the arm any more; its motors have switched themselves off", config.name)
    clear_away(config, key)


def clear_away(config: ArmConfig | BaseConfig, key: str) -> None:
    """Remove the files of an arm whose process was killed, unless another process drives the arm by now."""
    with contextlib.suppress(OSError, YamError):
        lock = FileLock(lock_path(key), config.channel)
        lock.acquire()
        state_path(key).unlink(missing_ok=True)
        forget_about(key)
        lock.release()


def still_in_the_air(who: str) -> str:
    """Return the message for a `stop` that returned False. `who`: subject and verb, such as "THE ARMS ARE"."""
    return (
        f"{who} STILL IN THE AIR: the control loop goes on holding, and lands as soon as it can. Clear the way. If the "
        "emergency stop is latched, release it then: yam-estop release"
    )
