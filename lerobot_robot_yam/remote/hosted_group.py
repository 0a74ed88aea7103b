"""Group of parts on the host: the robot's followers and base, or the leaders, driven by one client at a time."""

import logging
import threading
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ChannelInUseError, LifeCycleError, LinkError, YamError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.remote.hosted_part import HostedArm, HostedBase
from lerobot_robot_yam.remote.link_messages import Command
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.lease import Lease

logger = logging.getLogger(__name__)


class Phase(Enum):
    """Phase of a group."""

    FREE = "free"
    STARTING = "starting"
    RUNNING = "running"
    LANDING = "landing"


class HostedGroup:
    """Group of arms, and a base, that start and land together.

    Args:
        role: "robot" or "teleop".
        device: LeRobot type name of the local device.
        configs: prefix → config of the arm, in canonical order; a base has the prefix `BASE_PREFIX`.
        options: prefix → options for clients, which build LeRobot's device from these options.
        first: number of this group's first part among all parts of the host.
        isolation: where the control loop runs, see `ArmSession`.

    Attributes:
        phase: current phase.
        lease: right to drive the group, held by a client's session number.
        newest: number of the newest command from the client that holds the lease.
        channels: CAN channel of an arm of the group → command-line options that name the channel.
        dropped: number of dropped commands: refused, too old, out of order, or not from the holder of the lease.
    """

    def __init__(
        self,
        role: str,
        device: str,
        configs: Mapping[str, ArmConfig | BaseConfig],
        options: Mapping[str, Mapping[str, Any]],
        first: int,
        isolation: Isolation = "process",
    ):
        self.role, self.device, self.options = role, device, options
        self._session = ArmSession(list(configs.values()), isolation)
        self.parts: Sequence[HostedArm | HostedBase] = [
            HostedBase(number, self._session, config)
            if isinstance(config, BaseConfig)
            else HostedArm(number, self._session, config.name)
            for number, config in enumerate(configs.values(), first)
        ]
        self.prefixes = list(configs)
        self.channels = {
            config.channel: config.on_command_line for config in configs.values() if isinstance(config, ArmConfig)
        }
        self.phase, self.lease, self.newest = Phase.FREE, Lease(f"the host's {role}"), 0
        self.dropped = 0
        self._lock = threading.Lock()  # guards phase, lease, _over and _last
        self._over = 0  # last session that called `stop`
        # Last session, whether its arms have landed, and why they were not energised.
        self._last: tuple[int, bool, YamError | None] = (0, True, None)
        self._unwanted = threading.Event()
        self._worker: threading.Thread | None = None

    def told(self) -> dict[str, Any]:
        """Return the description of the group for a hello."""
        return {
            "device": self.device,
            "parts": {
                prefix: {"number": part.number, "key": part.key, "options": dict(self.options[prefix])}
                for prefix, part in zip(self.prefixes, self.parts, strict=True)
            },
            "phase": self.phase.value,
            "holder": self.lease.who,
            "calibrated": all(part.calibrated for part in self.parts),
            "dropped": self.dropped,
        }

    def start(self, session: int, who: str, search: bool) -> bool:
        """Energise the arms for a client. Return whether they are energised; the client resends the request until then.

        Raises:
            ChannelInUseError: another client drives the group.
            LifeCycleError: this client has already released the group.
            YamError: the arms could not be energised.
        """
        with self._lock:
            self.lease.check(session)
            if self.phase is Phase.RUNNING:
                return True
            last, _, error = self._last
            if session == last and error is not None:
                raise error
            if session in (self._over, last, self.lease.holder) and self.phase is not Phase.STARTING:
                raise LifeCycleError(f"this client's {self.role} has been let go of; connect again")
            if self.phase is Phase.LANDING:
                raise ChannelInUseError(f"the host's {self.role} still lands its arms; try again in a moment")
            if self.phase is Phase.FREE:
                self.lease.take(session, who)
                self.phase, self.newest = Phase.STARTING, 0
                self._unwanted.clear()
                for part in self.parts:
                    part.begin()
                name, work = f"yam-{self.role}", (session, search)
                self._worker = threading.Thread(target=self._run, args=work, name=name, daemon=False)
                self._worker.start()
            return False

    def _run(self, session: int, search: bool) -> None:
        """Energise the arms; land them once the client no longer wants them."""
        landed, error = False, None
        try:
            self._session.start(search_grippers=search)
            with self._lock:
                if self.phase is Phase.STARTING:
                    self.phase = Phase.RUNNING
            logger.info("%s: energised for %s", self.role, self.lease.who)
            self._unwanted.wait()
        except YamError as failure:
            error = failure
        except Exception as failure:
            logger.exception("%s did not start", self.role)
            error = YamError(f"the host has failed: {failure!r}")
        try:
            landed = self._session.stop()  # True if the session has not started
        except Exception:
            logger.exception("%s: landing", self.role)
        logger.info("%s: let go of by %s, %s", self.role, self.lease.who, "landed" if landed else "NOT DOWN YET")
        with self._lock:
            self._last = (session, landed, error)
            self.lease.release()
            self.phase = Phase.FREE

    def stop(self, session: int) -> bool | None:
        """Land this client's arms and release them. Return whether they have landed; None: not yet, the client resends.

        A client that never had the arms gets True.
        """
        with self._lock:
            self._over = session
            if self.lease.holder != session:
                last, landed, _ = self._last
                return landed or session != last
            self._begin_landing()
            return None

    def land(self, why: str) -> None:
        """Land the arms without a client's request, if they are in the air."""
        with self._lock:
            if self.phase in (Phase.STARTING, Phase.RUNNING):
                logger.warning("%s: lands, %s", self.role, why)
                self._begin_landing()

    def _begin_landing(self) -> None:
        if not self._unwanted.is_set():
            self.phase = Phase.LANDING
            self._session.begin_stop()
            self._unwanted.set()

    def heard(self, session: int) -> bool:
        """Record a heartbeat of a session. Return whether the session holds the lease of these arms."""
        return self.lease.renew(session)

    def take(self, command: Command) -> None:
        """Forward a client's command to its part. Raises LinkError: the command is old, or not from the holder."""
        if self.phase is not Phase.RUNNING or self.lease.holder != command.session:
            self.dropped += 1
            raise LinkError(f"a command for the {self.role} is not of the client that has it")
        if command.number <= self.newest:
            self.dropped += 1
            raise LinkError(f"a command for the {self.role} has come before")
        self.newest = command.number
        self.lease.renew(command.session)
        part = next(part for part in self.parts if part.number == command.part)
        if not part.take(command.record):
            self.dropped += 1

    @property
    def silent_s(self) -> float:
        """Silence of the client that drives the arms, s; 0 without a client."""
        return self.lease.silent_s if self.phase is Phase.RUNNING else 0.0

    @property
    def led_by_hand(self) -> bool:
        """Whether a person seems to hold one of these leaders."""
        return any(part.in_a_hand for part in self.parts)

    def close(self) -> None:
        """Land the arms and wait until they have landed."""
        self.land("the host ends")
        if self._worker is not None:
            self._worker.join()
