"""One arm of the host: its client's commands become targets and requests, its states are passed on."""

import logging
import math
import struct
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from lerobot_robot_yam.errors import LifeCycleError, StaleStateError, YamError
from lerobot_robot_yam.remote.wire.link_messages import ArmNews
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE, Request

logger = logging.getLogger(__name__)

_ANSWERED_AT = STATE_DTYPE.fields["request_sequence"][1]  # type: ignore[index]
_MODE_AT = STATE_DTYPE.fields["mode"][1]  # type: ignore[index]
_NUMBER = struct.Struct("<Q")
_AHEAD_S = 0.05  # by which a command may seem to come from the future: clocks are known that well
_PERMITTED_MOST_S = 0.5  # for which a client may permit a follower to go on with its leader
_REFUSED = "the host refuses: {}"


class HostedArm:
    """One arm.

    Args:
        number: among all arms of the host.
        session: which has it.
        name: of the arm there.
    """

    def __init__(self, number: int, session: ArmSession, name: str):
        self.number, self.key = number, session.key(name)
        self._session, self._name = session, name
        self._client: ArmClient | None = None
        self._targets = self._requests = 0  # newest numbers of the client's
        self._asked = (0, 0)  # number of the newest request here, and what the client calls it
        self._answered = 0  # what the client called the one before
        self._refused: tuple[int, str] | None = None  # a request that was not even passed on

    @property
    def calibrated(self) -> bool:
        """Whether its gripper's stops are configured or stored, or need not be."""
        hardware = self._session.hardware(self._name)
        config = hardware.config
        known = config.gripper_stops_rad is not None or Path(config.calibration_path or "").is_file()
        return known or not hardware.has_gripper

    def begin(self) -> None:
        """The session runs."""
        self._client = self._session[self._name]
        self._targets = self._requests = self._answered = 0
        self._asked, self._refused = (0, 0), None

    def end(self) -> None:
        """The session has ended."""
        self._client = None

    def take(self, record: bytes, leaders: Collection[str]) -> bool:
        """Pass on what is new in a client's command record. False: a target in it was not taken.

        Args:
            record: of COMMAND_DTYPE, by the clock of the host's arms.
            leaders: keys of the arms that a follower may follow.

        A request goes first: the client has waited for its answer before it gave a target.
        """
        client, hardware = self._client, self._session.hardware(self._name)
        if client is None:
            return False
        command = np.frombuffer(record, COMMAND_DTYPE, count=1)[0]
        if command["request_sequence"] > self._requests:
            self._requests = int(command["request_sequence"])
            self._ask(client, command)
        if command["target_sequence"] <= self._targets:
            return True
        self._targets = int(command["target_sequence"])
        now, given_s = self._session.clock.now(), float(command["target_stamp_s"])
        if not -_AHEAD_S <= now - given_s <= hardware.config.command_timeout_s:  # NaN, too
            return False
        try:
            self._write_target(client, command, min(given_s, now), leaders)
        except YamError as error:
            logger.debug("%s: a client's target was not taken: %s", self._name, error)
            return False
        return True

    def _ask(self, client: ArmClient, command: np.void) -> None:
        number = self._requests
        try:
            request = Request(int(command["request"]))
            if request is Request.CUT_TORQUE:
                raise LifeCycleError(f"{self._name}: an arm that does not lie falls; cut torque at its own computer")
            gains: Sequence[float] = ()
            if request is Request.GAINS:
                j = client.hardware.joints
                gains = client.checked_gains(command["own_kp"][:j], command["own_kd"][:j])
        except (YamError, ValueError) as error:
            self._refused = (number, _REFUSED.format(error))
            return
        self._answered = self._asked[1]
        self._asked = (client.ask(request, gains), number)

    def _write_target(self, client: ArmClient, command: np.void, given_s: float, leaders: Collection[str]) -> None:
        hardware = client.hardware
        j = hardware.joints
        gripper = float(command["q"][j]) if hardware.has_gripper else None
        if client.mode() is Mode.FLOAT:
            client.guide_on(gripper)
            return
        options = {
            field: command[field][:j].tolist() for field in ("dq", "kp", "kd") if not np.isnan(command[field][:j]).all()
        }
        coupled = None
        if leader := command["leader"].item().decode(errors="replace"):
            permitted_s = float(command["coupled_until_s"] - command["target_stamp_s"])  # from when it arrives on
            if leader not in leaders or not 0.0 <= permitted_s <= _PERMITTED_MOST_S:
                raise LifeCycleError(f"{self._name}: cannot follow {leader} for {permitted_s:g} s")
            coupled = (leader, permitted_s)
        client.write_target(command["q"][:j], gripper, **options, coupled=coupled, given_s=given_s)

    def news(self) -> ArmNews | None:
        """Its newest state, with the answer to its client's newest request; None while it does not run."""
        client = self._client
        if client is None:
            return None
        try:
            payload = client.payload()
        except (YamError, ValueError):  # it was closed meanwhile; its loop died in the middle of a write
            return None
        if payload is None:
            return None
        asked, answered = self._asked
        (done,) = _NUMBER.unpack_from(payload, _ANSWERED_AT)
        if done < asked:
            answered = self._answered
        if self._refused is not None and self._refused[0] > answered:
            record = np.frombuffer(payload, STATE_DTYPE, count=1).copy()
            answered, text = self._refused
            record["request_refused"], record["refusal"] = 1, text.encode()[:400]
            payload = record.tobytes()
        return ArmNews(self.number, answered, payload)

    @property
    def running(self) -> bool:
        """Whether it has states."""
        return self._client is not None

    @property
    def period_s(self) -> float:
        """Of its control loop."""
        return 1.0 / max(self._session.hardware(self._name).config.rate_hz, 100.0)

    def sequence(self) -> int:
        """Number of its newest state in its block."""
        client = self._client
        try:
            return 0 if client is None else client.sequence()
        except (YamError, ValueError):  # closed meanwhile
            return 0

    def away(self, gates: Collection[Gate], by_rad: float) -> bool:
        """Whether its gate is one of these, and a joint is farther than that from where the arm lands."""
        client = self._client
        if client is None:
            return False
        try:
            state = client.published()
        except (StaleStateError, LifeCycleError, ValueError):
            return False
        far = bool((np.abs(state.q - client.hardware.rest_q) > by_rad).any()) if len(state.q) else False
        return state.gate in gates and far and all(map(math.isfinite, state.q))
