"""One question to a host, from a program that has no link to it."""

import itertools
import platform
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lerobot_robot_yam import errors
from lerobot_robot_yam.errors import LinkError, YamError
from lerobot_robot_yam.remote.wire.curve_keys import ClientKey
from lerobot_robot_yam.remote.wire.host_address import HostAddress, package_version
from lerobot_robot_yam.remote.wire.link_messages import Kind, kind_of, pack_ask, unpack_json
from lerobot_robot_yam.remote.wire.transport import ClientSockets, reaching

HELLO_S = 2.0
_AGAIN_S = 0.5
_WAIT_S = 0.01


@dataclass(frozen=True)
class Host:
    """A host as a client names it.

    Attributes:
        address: where it is.
        key: path of this client's key; None: none.
    """

    address: HostAddress
    key: str | None = None

    def client_key(self) -> ClientKey | None:
        """The key itself. Raises ConfigError: it cannot be read."""
        return None if self.key is None else ClientKey.load(self.key)

    def ask(self, op: str, within_s: float = HELLO_S, **fields: Any) -> dict[str, Any]:
        """Ask, and wait for the answer.

        Raises:
            LinkError: no answer comes.
            YamError: the host refuses, with the error that it has met.
        """
        with reaching(self.address):
            sockets = ClientSockets(self.address, self.client_key(), states=False)

            def turn() -> None:
                sockets.wait(_WAIT_S)
                while (message := sockets.receive()) is not None:
                    asker.hear(message)

            asker = Asker(self, sockets, turn)
            try:
                return asker.ask(op, within_s, **fields)
            finally:
                sockets.close()


class Asker:
    """Asks over sockets that are open.

    Args:
        host: who is asked.
        sockets: to it.
        turn: called again and again while it waits: lets a little time pass, and gives what comes to `hear`.
    """

    def __init__(self, host: Host, sockets: ClientSockets, turn: Callable[[], None]):
        self._host, self._sockets, self._turn = host, sockets, turn
        self._numbers = itertools.count(secrets.randbits(31))
        self._answer: dict[str, Any] = {}

    def hear(self, message: bytes) -> None:
        """Take an answer. Raises LinkError: it is none, or of another version."""
        if kind_of(message) is not Kind.ANSWER:
            raise LinkError(f"{self._host.address} answers with what is no answer")
        self._answer = unpack_json(message)

    def ask(
        self, op: str, within_s: float, unwanted: Callable[[], bool] = lambda: False, **fields: Any
    ) -> dict[str, Any]:
        """See `Host.ask`; empty once `unwanted` says True. An answer may get lost with its connection, so it is asked
        again and again."""
        number, deadline, again_s = next(self._numbers), time.monotonic() + within_s, 0.0
        while (now := time.monotonic()) < deadline:
            if now >= again_s and self._sockets.send(pack_ask(number, op, **fields)):
                again_s = now + _AGAIN_S
            self._turn()
            if self._answer.get("number") == number:
                return _checked(self._answer)
            if unwanted():
                return {}
        raise LinkError(
            f"no yam-host answers at {self._host.address} within {within_s:g} s: is it running, and is this computer "
            "paired? `yam-host status` says so there"
        )


def _checked(answer: dict[str, Any]) -> dict[str, Any]:
    if "error" in answer:
        kind = getattr(errors, str(answer.get("kind")), YamError)
        raise (kind if isinstance(kind, type) and issubclass(kind, YamError) else YamError)(str(answer["error"]))
    return answer


def hello(host: Host) -> dict[str, Any]:
    """What a host is and has.

    Raises:
        LinkError: no answer comes, or it has another version of this package.
    """
    told = host.ask("hello", computer=platform.node())
    theirs, ours = told.get("package"), package_version()
    if theirs != ours:
        raise LinkError(
            f"{host.address} has lerobot_robot_yam {theirs}, this computer {ours}; install the same version on both"
        )
    return told
