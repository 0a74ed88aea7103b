"""The wire between the controller and its clients: one JSON object per line, over TCP.

    {"id": 7, "do": "move_j", "with": {"angles": [0, 60, 60, -29, 0, 0]}}   a request
    {"id": 7, "result": 3}                                                  its answer
    {"id": 7, "refused": "joint_2 would be at 215.00°, beyond its …"}        or this

Requests of one connection are begun in their order; answers come when they are ready. After the request "stream" the
connection carries statuses, one per line, and nothing else.
"""

import json
from typing import Any

HOST, PORT = "127.0.0.1", 5001  # Commander's own defaults
STREAM = "stream"
MOST_BYTES = 1 << 20  # of a line; the longest is a list of shapes


def encode(message: dict[str, Any]) -> bytes:
    """A message as a line. Arrays become lists; NaN stays NaN, for the controller to refuse."""
    return json.dumps(message, separators=(",", ":"), default=_plain).encode() + b"\n"


def decode(line: bytes) -> dict[str, Any]:
    """The message of a line. Raises ValueError: it is none."""
    message = json.loads(line)
    if not isinstance(message, dict):
        raise ValueError("not a JSON object")
    return message


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be sent")
