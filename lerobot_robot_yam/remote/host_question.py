"""Requests to a host, over the sockets of a link or over separate sockets."""

import contextlib
import itertools
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lerobot_robot_yam import errors
from lerobot_robot_yam.errors import LinkError, YamError
from lerobot_robot_yam.remote.host_address import HostAddress, package_version
from lerobot_robot_yam.remote.link_keys import LinkKey
from lerobot_robot_yam.remote.link_messages import Answer, Beat, Echo, Question
from lerobot_robot_yam.remote.link_sockets import ClientSockets
from lerobot_robot_yam.system.clock import SYSTEM

HELLO_S = 2.0  # default timeout of a request, s
_AGAIN_S = 0.1  # resend interval of a request until its result arrives, s
_WAIT_S = 0.01  # maximum wait for one message from the host, s
_numbers = itertools.count(secrets.randbits(31))


@dataclass(frozen=True)
class Host:
    """Host, with the key file that a client uses.

    Attributes:
        address: address and port of the host.
        key: path of this client's key file; None if the client has no key.
    """

    address: HostAddress
    key: str | None = None

    def client_key(self) -> LinkKey | None:
        """Read the key file. Raises ConfigError: the file cannot be read."""
        return None if self.key is None else LinkKey.load(self.key)

    def ask(self, op: str, within_s: float = HELLO_S, **fields: Any) -> dict[str, Any]:
        """Send a request and return its result.

        Args:
            op: see `Question`.
            within_s: timeout, s.
            fields: other fields of the `Question`.

        Raises:
            LinkError: the host does not reply.
            YamError: the host refuses; the error has the same class as on the host.
        """
        with contextlib.closing(ClientSockets(self.address, self.client_key(), states=False)) as sockets:
            ahead_s: float | None = None  # host's clock minus the local clock, or less by the way of its reply

            def turn() -> Answer | None:
                nonlocal ahead_s
                if ahead_s is None:
                    sockets.send(Beat(0, "", SYSTEM.now(), False))
                sockets.wait(_WAIT_S)
                message = sockets.receive()
                if isinstance(message, Echo):
                    ahead_s = message.answered_s - SYSTEM.now()
                return message if isinstance(message, Answer) else None

            return ask_over(sockets, turn, self.address, op, within_s, lambda: ahead_s, **fields)


def ask_over(
    sockets: ClientSockets,
    turn: Callable[[], Answer | None],
    address: HostAddress,
    op: str,
    within_s: float,
    ahead_s: Callable[[], float | None],
    unwanted: Callable[[], bool] = lambda: False,
    **fields: Any,
) -> dict[str, Any]:
    """Send a request over open sockets and return its result; see `Host.ask`.

    Args:
        sockets: sockets to the host.
        turn: callback that waits briefly and returns a received reply, or None.
        address: address of the host.
        op, within_s, fields: see `Host.ask`.
        ahead_s: callback that returns the host's clock minus the local clock, s; None while unknown.
        unwanted: callback that cancels the request by returning True; the result is then empty.
    """
    number, dated = next(_numbers), False
    deadline, again_s, heard = SYSTEM.now() + within_s, 0.0, False
    while (now := SYSTEM.now()) < deadline:
        ahead = ahead_s()
        if now >= again_s or (ahead is not None and not dated):
            sent_s = 0.0 if ahead is None else max(0.0, now + ahead)
            if sockets.send(Question(number, op, sent_s, **fields)):  # type: ignore[arg-type]
                again_s, dated = now + _AGAIN_S, ahead is not None
        answer = turn()
        if answer is not None and answer.number == number:
            heard = True
            if answer.error:
                kind = getattr(errors, answer.kind, YamError)
                raise (kind if isinstance(kind, type) and issubclass(kind, YamError) else YamError)(answer.error)
            if answer.result is not None:
                return answer.result
        if unwanted():
            return {}
    if heard:
        raise LinkError(f"the yam-host at {address} has not done it within {within_s:g} s ({op})")
    raise LinkError(
        f"no yam-host answers at {address} within {within_s:g} s: is it running, and is this computer paired? "
        "`yam-host status` says so there"
    )


def hello(host: Host) -> dict[str, Any]:
    """Return the host's description of itself and its arms.

    Raises:
        LinkError: the host does not reply, or has another version of this package.
    """
    told = host.ask("hello")
    theirs, ours = told.get("package"), package_version()
    if theirs != ours:
        raise LinkError(
            f"{host.address} has lerobot_robot_yam {theirs}, this computer {ours}; install the same version on both"
        )
    return told
