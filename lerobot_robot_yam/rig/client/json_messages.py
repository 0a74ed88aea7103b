"""JSON messages between the rig's processes: single packets, or lines of a pipe."""

import json
from collections.abc import Iterator, Mapping
from typing import Any


def to_json(message: Mapping[str, Any]) -> bytes:
    """Encode a message on one line; values of numpy become lists and numbers."""
    return json.dumps(message, default=_plain).encode()


def to_line(message: Mapping[str, Any]) -> bytes:
    """Encode a message with the line feed by which `LineReader` finds its end."""
    return to_json(message) + b"\n"


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")


class LineReader:
    """Splits a pipe's bytes into messages; an incomplete line waits for the next chunk."""

    def __init__(self) -> None:
        self._rest = b""

    def read(self, chunk: bytes) -> Iterator[dict[str, Any]]:
        """Yield the messages that a chunk completes."""
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            yield json.loads(line)
