"""Arm on the host: forwards its client's commands as targets and requests, and returns its states."""

import contextlib
import logging
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import GripperError, LifeCycleError, YamError
from lerobot_robot_yam.session.arm_client import REQUEST_TIMEOUT_S, ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE, Request

logger = logging.getLogger(__name__)

_TEXTS_AT = STATE_DTYPE.fields["refusal"][1]  # type: ignore[index]
_NO_TEXTS = bytes(STATE_DTYPE.itemsize - _TEXTS_AT)
_AHEAD_S = 0.05  # tolerance for commands from the future, s: the error of the clock offset
_PERMITTED_MOST_S = 0.5  # maximum time for which a client may couple a follower to its leader, s
_LED = (Gate.APPROACH, Gate.ENGAGED, Gate.FINE, Gate.RECENTRE)
_OUT_OF_HOME_RAD = 0.3


class HostedArm:
    """Arm on the host.

    Args:
        number: number of the arm among all arms of the host.
        session: session that contains the arm.
        name: the arm's name in the session.
    """

    def __init__(self, number: int, session: ArmSession, name: str):
        self.number, self.key, self._name = number, session.key(name), name
        self._session, self._hardware = session, session.hardware(name)
        self._target = self._request = 0  # newest numbers of the client's targets and requests

    @property
    def calibrated(self) -> bool:
        """Whether the gripper's stops are configured or stored, or there is no gripper motor."""
        config = self._hardware.config
        known = config.gripper_stops_rad is not None or Path(config.calibration_path or "").is_file()
        return known or not self._hardware.has_gripper

    @property
    def client(self) -> ArmClient | None:
        """Client of the arm in the session; None while the session is not running."""
        with contextlib.suppress(LifeCycleError):
            return self._session[self._name]
        return None

    def begin(self) -> None:
        """Reset the command numbers for a new client of the host."""
        self._target = self._request = 0

    def take(self, record: bytes, leaders: Collection[str]) -> bool:
        """Forward the request and the target in a client's command record, if they are new.

        A request is forwarded before a target, because the client waits for the reply before it sends a target. The
        request keeps its number, by which the client finds the reply in the arm's states.

        Args:
            record: bytes of COMMAND_DTYPE, with times in the host's clock.
            leaders: channel keys of the leaders that a follower may follow.

        Returns:
            False if the session is not running, or if the request or target was refused, for instance as too old.
        """
        command, client = np.frombuffer(record, COMMAND_DTYPE)[0], self.client
        target, request, taken = int(command["target_sequence"]), int(command["request_sequence"]), client is not None
        if client is not None and request > self._request:
            try:
                self._ask(client, command, request)
            except YamError as error:
                taken = False
                logger.warning("%s: a client's request is not carried out: %s", self._name, error)
        if client is not None and target > self._target:
            try:
                self._give(client, command, leaders)
            except YamError as error:
                taken = False
                logger.debug("%s: a client's target is not taken: %s", self._name, error)
        self._target, self._request = max(target, self._target), max(request, self._request)
        return taken

    def _check_age(self, stamp_s: float, most_s: float) -> None:
        """Check the timestamp of a request or target. Raises LifeCycleError: it is too old, or in the future."""
        age_s = self._session.clock.now() - stamp_s
        if not -_AHEAD_S <= age_s <= most_s:  # also True for NaN
            raise LifeCycleError(f"it is {age_s:.1f} s old")

    def _ask(self, client: ArmClient, command: Any, number: int) -> None:
        self._check_age(command["request_stamp_s"], REQUEST_TIMEOUT_S)  # a client does not wait longer
        try:
            request = Request(command["request"])
        except ValueError as error:
            raise LifeCycleError(str(error)) from error
        if request is Request.CUT_TORQUE:
            raise LifeCycleError("an arm that does not lie falls; cut torque at its own computer")
        kp, kd = (command[name][: self._hardware.joints] for name in ("own_kp", "own_kd"))
        client.ask(request, client.checked_gains(kp, kd) if request is Request.GAINS else (), number)

    def _give(self, client: ArmClient, command: Any, leaders: Collection[str]) -> None:
        given_s, joints = float(command["target_stamp_s"]), self._hardware.joints
        self._check_age(given_s, self._hardware.config.command_timeout_s)
        gripper = command["q"][joints] if self._hardware.has_gripper else None
        try:
            mode = client.newest().mode
        except GripperError:  # a guided arm may keep floating without known stops
            mode = client.mode()
        if mode is Mode.FLOAT:
            client.guide_on(gripper)
            return
        options = {name: row for name in ("dq", "kp", "kd") if not np.isnan(row := command[name][:joints]).all()}
        coupled = None
        if leader := command["leader"].decode(errors="replace"):
            permitted_s = float(command["coupled_until_s"]) - given_s  # counted from the target's arrival
            if leader not in leaders or not 0.0 <= permitted_s <= _PERMITTED_MOST_S:
                raise LifeCycleError(f"it cannot follow {leader} for {permitted_s:g} s")
            coupled = (leader, permitted_s)
        given_s = min(given_s, self._session.clock.now())
        client.write_target(command["q"][:joints].tolist(), gripper, **options, coupled=coupled, given_s=given_s)

    def record(self) -> bytes | None:
        """Return the newest state record without empty texts at its end; None while the arm is not running."""
        client = self.client
        try:
            record = None if client is None else client.payload()
        except (YamError, ValueError):  # closed in the meantime, or the loop died while writing a record
            return None
        return record[:_TEXTS_AT] if record is not None and record.endswith(_NO_TEXTS) else record

    @property
    def in_a_hand(self) -> bool:
        """Whether a person seems to hold this leader: the leader is engaged and away from its rest pose."""
        try:
            state = self._session[self._name].published()
        except (YamError, ValueError):
            return False
        away = np.abs(state.q - self._hardware.rest_q) > _OUT_OF_HOME_RAD
        return state.gate in _LED and bool(away.any() and np.isfinite(state.q).all())
