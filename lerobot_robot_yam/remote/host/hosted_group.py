"""A group of arms of the host: the robot's followers or the teleoperator's leaders, which one client at a time has."""

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ChannelInUseError, LifeCycleError, LinkError, YamError
from lerobot_robot_yam.remote.host.hosted_arm import HostedArm
from lerobot_robot_yam.remote.wire.link_messages import Command
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.state.modes import Gate
from lerobot_robot_yam.system.clock import SYSTEM

logger = logging.getLogger(__name__)

Reply = Callable[[Mapping[str, Any]], None]
"""Sends the answer to a question; from any thread."""

_LED = (Gate.APPROACH, Gate.ENGAGED, Gate.FINE, Gate.RECENTRE)
_OUT_OF_HOME_RAD = 0.3
_MOST_WAITING = 8  # who asks again has another connection


class Phase(Enum):
    """Of a group."""

    FREE = "free"
    STARTING = "starting"
    RUNNING = "running"
    LANDING = "landing"


@dataclass
class Holder:
    """The client that has the group.

    Attributes:
        session: the number that it has given itself, which its commands carry.
        who: user, computer and process.
        sequence: of its newest command.
        heard_s: when it was heard last, s.
    """

    session: int
    who: str
    sequence: int = 0
    heard_s: float = field(default_factory=SYSTEM.now)


class HostedGroup:
    """One group.

    Args:
        role: "robot" or "teleop".
        device: LeRobot's type name of the local device.
        arms: by prefix, in canonical order.
        options: what a client is told of each, by prefix: the options of LeRobot's device.
        first: number of the first arm among all arms of the host.
        isolation: where their control loop runs, see `ArmSession`.

    Attributes:
        phase, holder: what it does, and for which client.
        leaders: keys of the arms that its followers may follow; set by the server.
        channels: its CAN channels, and what names each on a command line.
        dropped: commands that were not the holder's, too old, or not newer than the last.
    """

    def __init__(
        self,
        role: str,
        device: str,
        arms: Mapping[str, ArmConfig],
        options: Mapping[str, Mapping[str, Any]],
        first: int,
        isolation: Isolation = "process",
    ):
        self.role, self.device, self.options = role, device, options
        self._session = ArmSession(list(arms.values()), isolation)
        self.arms = [
            HostedArm(first + number, self._session, config.name) for number, config in enumerate(arms.values())
        ]
        self.prefixes = list(arms)
        self.channels = {config.channel: config.on_command_line for config in arms.values()}
        self.phase = Phase.FREE
        self.holder: Holder | None = None
        self.leaders: frozenset[str] = frozenset()
        self.dropped = 0
        self._lock = threading.Lock()  # of phase, holder and waiting
        self._waiting: list[Reply] = []
        self._unwanted = False  # they land as soon as they have been energised
        self._over = 0  # session of the client that has let go last
        self._landed = (0, True)  # session whose arms were landed last, and whether they came down
        self._worker: threading.Thread | None = None

    def told(self) -> dict[str, Any]:
        """What a hello says of it."""
        holder = self.holder
        return {
            "device": self.device,
            "arms": {
                prefix: {"number": arm.number, "key": arm.key, "options": dict(self.options[prefix])}
                for prefix, arm in zip(self.prefixes, self.arms, strict=True)
            },
            "phase": self.phase.value,
            "holder": "" if holder is None else holder.who,
            "calibrated": all(arm.calibrated for arm in self.arms),
            "dropped": self.dropped,
        }

    def start(self, session: int, who: str, search: bool, reply: Reply) -> None:
        """Energise the arms for a client; asked again by the same one it answers when they are.

        Raises:
            ChannelInUseError: another client has them.
            LifeCycleError: this one has let go of them already.
        """
        with self._lock:
            holder = self.holder
            if holder is not None and holder.session != session:
                raise ChannelInUseError(f"the host's {self.role} is driven by {holder.who}; end that first")
            if self.phase is Phase.RUNNING:
                reply({"ready": True})
                return
            if session == self._over:  # this question was overtaken
                raise LifeCycleError(f"this client has let go of the host's {self.role}")
            if self.phase is Phase.LANDING or self._unwanted:
                raise ChannelInUseError(f"the host's {self.role} still lands its arms; try again in a moment")
            self._waiting = [*self._waiting[-_MOST_WAITING:], reply]
            if self.phase is Phase.FREE:
                self.phase, self.holder = Phase.STARTING, Holder(session, who)
                self._work(lambda: self._start(search))

    def _start(self, search: bool) -> None:
        answer: dict[str, Any] = {"ready": True}
        try:
            self._session.start(search_grippers=search)
            for arm in self.arms:
                arm.begin()
            logger.info("%s: energised for %s", self.role, self._who)
        except YamError as error:
            answer = {"error": str(error), "kind": type(error).__name__}
        except Exception as error:
            logger.exception("%s did not start", self.role)
            answer = {"error": f"the host has failed: {error!r}", "kind": "YamError"}
        with self._lock:
            if "error" in answer:
                self.phase, self.holder = Phase.FREE, None
                answer, self._unwanted = {"landed": True} if self._unwanted else answer, False
            else:
                self.phase = Phase.LANDING if self._unwanted else Phase.RUNNING
            if self.phase is not Phase.LANDING:
                self._answer(answer)
                return
        self._land()

    @property
    def _who(self) -> str:
        return "" if self.holder is None else self.holder.who

    def stop(self, session: int, reply: Reply) -> None:
        """Land the arms of this client, and let go of them. Asked again it gives the same answer; one that never had
        them is told that they are down."""
        with self._lock:
            self._over = session
            if self.holder is None or self.holder.session != session:
                last, landed = self._landed
                reply({"landed": landed or session != last})
                return
            self._begin_landing()
            self._waiting = [*self._waiting[-_MOST_WAITING:], reply]

    def land(self, why: str) -> None:
        """Land them without being asked, if they are in the air."""
        with self._lock:
            if self.phase in (Phase.STARTING, Phase.RUNNING):
                logger.warning("%s: lands, %s", self.role, why)
                self._begin_landing()

    def _begin_landing(self) -> None:
        if self.phase is Phase.RUNNING:
            self.phase = Phase.LANDING
            self._work(self._land)
        elif self.phase is Phase.STARTING and not self._unwanted:
            self._unwanted = True
            self._answer({"error": "the host lets go of the arms again", "kind": "LifeCycleError"})
            self._session.begin_stop()

    def _land(self) -> None:
        landed = False
        try:
            landed = self._session.stop()
        except Exception:
            logger.exception("%s: landing", self.role)
        for arm in self.arms:
            arm.end()
        logger.info("%s: let go of by %s, %s", self.role, self._who, "landed" if landed else "NOT DOWN YET")
        with self._lock:
            assert self.holder is not None
            self._landed = (self.holder.session, landed)
            self.phase, self.holder, self._unwanted = Phase.FREE, None, False
            self._answer({"landed": landed})

    def _answer(self, fields: Mapping[str, Any]) -> None:
        waiting, self._waiting = self._waiting, []
        for reply in waiting:
            reply(fields)

    def _work(self, work: Callable[[], None]) -> None:
        self._worker = threading.Thread(target=work, name=f"yam-{self.role}", daemon=False)
        self._worker.start()

    def heard(self, session: int) -> bool:
        """Note a sign of life; whether the session has these arms."""
        holder = self.holder
        if holder is None or holder.session != session:
            return False
        holder.heard_s = SYSTEM.now()
        return True

    def take(self, command: Command) -> None:
        """Pass a client's command on to its arm. Raises LinkError: it does not count."""
        holder = self.holder
        if holder is None or holder.session != command.session or self.phase is not Phase.RUNNING:
            self.dropped += 1
            raise LinkError(f"a command for the {self.role} is not of the client that has it")
        if command.sequence <= holder.sequence:
            self.dropped += 1
            raise LinkError(f"a command for the {self.role} has come before")
        holder.sequence, holder.heard_s = command.sequence, SYSTEM.now()
        arm = next(arm for arm in self.arms if arm.number == command.arm)
        if not arm.take(command.record, self.leaders):
            self.dropped += 1

    def silent_s(self) -> float:
        """For how long its client has said nothing; 0 without one."""
        holder = self.holder
        return 0.0 if holder is None or self.phase is not Phase.RUNNING else SYSTEM.now() - holder.heard_s

    @property
    def led_by_hand(self) -> bool:
        """Whether a person seems to have one of these leaders in the hand: it is engaged, and away from its rest."""
        return any(arm.away(_LED, _OUT_OF_HOME_RAD) for arm in self.arms)

    def close(self) -> None:
        """Land, and wait until that has ended."""
        self.land("the host ends")
        if self._worker is not None:
            self._worker.join()
