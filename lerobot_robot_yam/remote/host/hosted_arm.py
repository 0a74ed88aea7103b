"""One arm of the host: its client's commands become targets and requests, its states are passed on."""

import logging
import math
import struct
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import GripperError, LifeCycleError, StaleStateError, YamError
from lerobot_robot_yam.remote.wire.link_messages import ArmNews
from lerobot_robot_yam.session.arm_client import REQUEST_TIMEOUT_S, ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE, Request, packed

logger = logging.getLogger(__name__)

_ANSWERED_AT = STATE_DTYPE.fields["request_sequence"][1]  # type: ignore[index]
_MODE_AT = STATE_DTYPE.fields["mode"][1]  # type: ignore[index]
_NUMBER = struct.Struct("<Q")
_AHEAD_S = 0.05  # by which a command may seem to come from the future: clocks are known that well
_PERMITTED_MOST_S = 0.5  # for which a client may permit a follower to go on with its leader
_REFUSED = "the host refuses: {}"
_OPTIONS = ("dq", "kp", "kd")  # of a target; NaN: not given
_Values = Sequence[Any]  # of a command record


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
        self._hardware = session.hardware(name)
        self._layout, self._at = packed(COMMAND_DTYPE, self._hardware.n)
        starts = {field: self._at[field] for field in ("q", *_OPTIONS, "own_kp", "own_kd")}
        self._joints = {field: slice(start, start + self._hardware.joints) for field, start in starts.items()}
        self._client: ArmClient | None = None
        self._targets = self._requests = 0  # newest numbers of the client's
        self._asked = (0, 0)  # number of the newest request here, and what the client calls it
        self._answered = 0  # what the client called the one before
        self._refused: tuple[int, str] | None = None  # a request that was not even passed on

    @property
    def calibrated(self) -> bool:
        """Whether its gripper's stops are configured or stored, or need not be."""
        config = self._hardware.config
        known = config.gripper_stops_rad is not None or Path(config.calibration_path or "").is_file()
        return known or not self._hardware.has_gripper

    def begin(self) -> None:
        """The session runs."""
        self._client = self._session[self._name]
        self._targets = self._requests = self._answered = 0
        self._asked, self._refused = (0, 0), None

    def end(self) -> None:
        """The session has ended."""
        self._client = None

    def take(self, record: bytes, leaders: Collection[str]) -> bool:
        """Pass on what is new in a client's command record. False: something in it was too old, or not taken.

        Args:
            record: of COMMAND_DTYPE, by the clock of the host's arms.
            leaders: keys of the arms that a follower may follow.

        A request goes first: the client has waited for its answer before it gave a target.
        """
        client = self._client
        if client is None:
            return False
        command = self._layout.unpack(record)
        now, taken = self._session.clock.now(), True
        if command[self._at["request_sequence"]] > self._requests:
            self._requests = command[self._at["request_sequence"]]
            age_s = now - command[self._at["request_stamp_s"]]
            if taken := -_AHEAD_S <= age_s <= REQUEST_TIMEOUT_S:
                self._ask(client, command)
            else:
                logger.warning(
                    "%s: a request that is %.1f s old is dropped; its client took it for failed", self._name, age_s
                )
        if command[self._at["target_sequence"]] <= self._targets:
            return taken
        self._targets = command[self._at["target_sequence"]]
        given_s = command[self._at["target_stamp_s"]]
        if not -_AHEAD_S <= now - given_s <= self._hardware.config.command_timeout_s:  # NaN, too
            return False
        try:
            self._write_target(client, command, min(given_s, now), leaders)
        except YamError as error:
            logger.debug("%s: a client's target was not taken: %s", self._name, error)
            return False
        return taken

    def _ask(self, client: ArmClient, command: _Values) -> None:
        number = self._requests
        try:
            request = Request(command[self._at["request"]])
            if request is Request.CUT_TORQUE:
                raise LifeCycleError(f"{self._name}: an arm that does not lie falls; cut torque at its own computer")
            gains: Sequence[float] = ()
            if request is Request.GAINS:
                gains = client.checked_gains(*(command[self._joints[field]] for field in ("own_kp", "own_kd")))
        except (YamError, ValueError) as error:
            self._refused = (number, _REFUSED.format(error))
            return
        self._answered = self._asked[1]
        self._asked = (client.ask(request, gains), number)

    def _write_target(self, client: ArmClient, command: _Values, given_s: float, leaders: Collection[str]) -> None:
        joints = self._joints
        gripper = command[joints["q"].stop] if self._hardware.has_gripper else None
        try:
            mode = client.newest().mode
        except GripperError:  # an arm that is guided may float on all the same
            mode = client.mode()
        if mode is Mode.FLOAT:
            client.guide_on(gripper)
            return
        options = {field: row for field in _OPTIONS if not all(map(math.isnan, row := command[joints[field]]))}
        coupled = None
        if leader := command[self._at["leader"]].rstrip(b"\0").decode(errors="replace"):
            stamp_s, until_s = (command[self._at[name]] for name in ("target_stamp_s", "coupled_until_s"))
            permitted_s = until_s - stamp_s  # from when it arrives on
            if leader not in leaders or not 0.0 <= permitted_s <= _PERMITTED_MOST_S:
                raise LifeCycleError(f"{self._name}: cannot follow {leader} for {permitted_s:g} s")
            coupled = (leader, permitted_s)
        client.write_target(command[joints["q"]], gripper, **options, coupled=coupled, given_s=given_s)

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

    def next_state(self) -> tuple[int, float]:
        """Number of its newest state in its block, and when the next one is due, s."""
        client = self._client
        try:
            return (0, 0.0) if client is None else client.next_state()
        except (YamError, ValueError):  # closed meanwhile
            return 0, 0.0

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
