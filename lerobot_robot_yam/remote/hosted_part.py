"""Parts of a robot on the host, arms and a base: they forward their client's commands, and return their states."""

import contextlib
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import GripperError, LifeCycleError, LinkError, YamError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.base_target import Frame
from lerobot_robot_yam.session.arm_client import REQUEST_TIMEOUT_S, ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.base_client import BaseClient
from lerobot_robot_yam.state.base_records import BASE_COMMAND_DTYPE, BASE_STATE_DTYPE, BaseRequest
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE, Request

logger = logging.getLogger(__name__)

_AHEAD_S = 0.05  # tolerance for commands from the future, s: the error of the clock offset
_LED = (Gate.APPROACH, Gate.ENGAGED, Gate.FINE, Gate.RECENTRE)
_OUT_OF_HOME_RAD = 0.3

Forward = Callable[[Any, int], None]


class HostedPart[Client: (ArmClient, BaseClient)](ABC):
    """Part on the host.

    Args:
        number: number of the part among all parts of the host.
        session: session that contains the part.
        name: the part's name in the session.
    """

    _states: np.dtype
    _commands: np.dtype

    def __init__(self, number: int, session: ArmSession, name: str):
        self.number, self.key, self._name, self._session = number, session.key(name), name, session
        self._texts_at = self._states.fields["refusal"][1]  # type: ignore[index]
        self._no_texts = bytes(self._states.itemsize - self._texts_at)
        self.leaders: Collection[str] = ()  # channel keys of the leaders that the part may follow; set by its group
        self.begin()

    @abstractmethod
    def _client(self) -> Client:
        """Return the client of the part. Raises LifeCycleError: the session is not running."""

    @abstractmethod
    def _forwards(self, client: Client) -> Mapping[str, Forward]:
        """Return field with the number of a command → function that forwards the command, requests first.

        A function is called with the record and the number. It raises YamError if the command is refused.
        """

    @property
    @abstractmethod
    def calibrated(self) -> bool:
        """Whether the part needs no calibration."""

    @property
    def in_a_hand(self) -> bool:
        """Whether a person seems to hold the part."""
        return False

    @property
    def client(self) -> Client | None:
        """Client of the part in the session; None while the session is not running."""
        with contextlib.suppress(LifeCycleError):
            return self._client()
        return None

    def begin(self) -> None:
        """Reset the command numbers for a new client of the host."""
        self._newest: dict[str, int] = {}

    def take(self, record: bytes) -> bool:
        """Forward the request and the targets in a client's command record, if they are new.

        A request is forwarded before a target, because the client waits for the reply before it sends a target. The
        request keeps its number, by which the client finds the reply in the part's states.

        Args:
            record: bytes of the part's command record, with times in the host's clock.

        Returns:
            False if the session is not running, or if a request or target was refused, for instance as too old.

        Raises:
            LinkError: the record is that of another kind of part.
        """
        if len(record) != self._commands.itemsize:
            raise LinkError(f"a command for {self._name} has the wrong size")
        command, client = np.frombuffer(record, self._commands)[0], self.client
        if client is None:
            return False
        taken = True
        for field, forward in self._forwards(client).items():
            number, newest = int(command[field]), self._newest.get(field, 0)
            self._newest[field] = max(number, newest)
            if number > newest:
                try:
                    forward(command, number)
                except YamError as error:
                    taken = False
                    level = logging.WARNING if field == "request_sequence" else logging.DEBUG
                    logger.log(level, "%s: a client's command is not carried out: %s", self._name, error)
        return taken

    def _check_age(self, stamp_s: float, most_s: float) -> None:
        """Check the timestamp of a request or target. Raises LifeCycleError: it is too old, or in the future."""
        age_s = self._session.clock.now() - stamp_s
        if not -_AHEAD_S <= age_s <= most_s:  # also True for NaN
            raise LifeCycleError(f"it is {age_s:.1f} s old")

    def record(self) -> bytes | None:
        """Return the newest state record without empty texts at its end; None while the part is not running."""
        client = self.client
        try:
            record = None if client is None else client.payload()
        except (YamError, ValueError):  # closed in the meantime, or the loop died while writing a record
            return None
        return record[: self._texts_at] if record is not None and record.endswith(self._no_texts) else record


class HostedArm(HostedPart[ArmClient]):
    """Arm on the host, see `HostedPart`."""

    _states, _commands = STATE_DTYPE, COMMAND_DTYPE

    def __init__(self, number: int, session: ArmSession, name: str):
        super().__init__(number, session, name)
        self._hardware = session.hardware(name)

    def _client(self) -> ArmClient:
        return self._session[self._name]

    @property
    def calibrated(self) -> bool:
        """Whether the gripper's stops are configured or stored, or there is no gripper motor."""
        config = self._hardware.config
        known = config.gripper_stops_rad is not None or Path(config.calibration_path or "").is_file()
        return known or not self._hardware.has_gripper

    def _forwards(self, client: ArmClient) -> Mapping[str, Forward]:
        return {"request_sequence": partial(self._ask, client), "target_sequence": partial(self._give, client)}

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

    def _give(self, client: ArmClient, command: Any, _: int) -> None:
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
        leader = command["leader"].decode(errors="replace")
        if leader and leader not in self.leaders:
            raise LifeCycleError(f"it cannot follow {leader}")
        take_over = int(command["button"]), int(command["presses"])
        if take_over[0] > 2:
            raise LifeCycleError(f"a handle has no button {take_over[0]}")
        given_s = min(given_s, self._session.clock.now())
        client.write_target(
            command["q"][:joints].tolist(), gripper, **options, leader=leader, take_over=take_over, given_s=given_s
        )

    @property
    def in_a_hand(self) -> bool:
        """Whether a person seems to hold this leader: the leader is engaged and away from its rest pose."""
        try:
            state = self._session[self._name].published()
        except (YamError, ValueError):
            return False
        away = np.abs(state.q - self._hardware.rest_q) > _OUT_OF_HOME_RAD
        return state.gate in _LED and bool(away.any() and np.isfinite(state.q).all())


class HostedBase(HostedPart[BaseClient]):
    """Base on the host, see `HostedPart`."""

    _states, _commands = BASE_STATE_DTYPE, BASE_COMMAND_DTYPE

    def __init__(self, number: int, session: ArmSession, config: BaseConfig):
        super().__init__(number, session, config.name)
        self._rail = config.rail

    @property
    def calibrated(self) -> bool:
        """Whether the rail's travel and height are stored, or there is no rail."""
        return self._rail is None or self._rail.stored

    def _client(self) -> BaseClient:
        return self._session.base(self._name)

    def _forwards(self, client: BaseClient) -> Mapping[str, Forward]:
        return {
            "request_sequence": partial(self._ask, client),
            "target_sequence": partial(self._give, client),
            "rail_sequence": partial(self._give_rail, client),
        }

    def _ask(self, client: BaseClient, command: Any, number: int) -> None:
        self._check_age(command["request_stamp_s"], REQUEST_TIMEOUT_S)  # a client does not wait longer
        client.ask(_known(BaseRequest, command["request"]), number)

    def _give(self, client: BaseClient, command: Any, _: int) -> None:
        given_s = self._given_s(client, command["target_stamp_s"])
        frame = _known(Frame, command["frame"])
        if not command["pose"]:
            client.write_velocity(command["values"], frame, given_s)
        elif frame is Frame.GLOBAL:
            client.write_pose(command["values"], frame, given_s)
        else:
            raise LifeCycleError("a pose of another computer is one of the odometry")

    def _give_rail(self, client: BaseClient, command: Any, _: int) -> None:
        given_s, value = self._given_s(client, command["rail_stamp_s"]), float(command["rail_value"])
        (client.write_rail_height if command["rail_height"] else client.write_rail_velocity)(value, given_s)

    def _given_s(self, client: BaseClient, stamp_s: float) -> float:
        """Check the timestamp of a target, and return it; one in the future becomes the present time."""
        self._check_age(stamp_s, client.config.command_timeout_s)
        return min(float(stamp_s), self._session.clock.now())


def _known[Kind: (BaseRequest, Frame)](kind: type[Kind], value: Any) -> Kind:
    try:
        return kind(int(value))
    except ValueError as error:
        raise LifeCycleError(str(error)) from error
