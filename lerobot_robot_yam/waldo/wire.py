"""Protocol between clients and a controller: one JSON object per line, one request and its reply per connection.

    {"do": "move_j", "with": {"angles": [0, 60, 60, -29, 0, 0]}, "client": "5f0c", "number": 7}     a request
    {"result": 3}                                                    its reply
    {"refused": "joint_2 would be at 215.00°, beyond its …"}         or its refusal

Requests on separate connections may overtake each other. So a client sends its name and numbers its requests: a request
that was sent before a stop, but arrives after it, is refused. Name and number may be omitted.

After the request "stream", the connection carries statuses, one per line. Clients connect over TCP. Arming and landing
are reserved for the operator at this computer. Those requests use a Unix socket in the runtime directory, which only
the directory's user can open.
"""

import json
import socket
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.system.runtime_files import runtime_dir

HOST, PORT = "127.0.0.1", 5001  # same defaults as Commander
STREAM = "stream"
MOST_BYTES = 1 << 20  # maximum line length, bytes; the longest messages are lists of shapes
ANSWER_S = 1.0  # timeout for a reply that needs no work, s
_OPERATOR_S = 120.0  # timeout for an operator's request, s: finding the gripper's stops or landing may take long


def encode(message: dict[str, Any]) -> bytes:
    """Encode a message as one line. Arrays become lists. NaN stays NaN, so that the controller can refuse it."""
    return json.dumps(message, separators=(",", ":"), default=_plain).encode() + b"\n"


def decode(line: bytes) -> dict[str, Any]:
    """Decode a line. Raises ValueError: the line is not a JSON object."""
    message = json.loads(line)
    if not isinstance(message, dict):
        raise ValueError("not a JSON object")
    return message


def result_of(name: str, line: bytes) -> Any:
    """Return the result in a reply. Raises ControllerError: the request `name` was refused, or there is no reply."""
    if not line:
        raise ControllerError(f"{name}: the controller ended before it was done; see its terminal")
    answer = decode(line)
    if "refused" in answer:
        raise ControllerError(answer["refused"])
    return answer.get("result")


def ask_once(host: str, port: int, name: str) -> Any:
    """Send one request without arguments. Return the result, or None if no controller replies or it refuses."""
    try:
        with socket.create_connection((host, port), ANSWER_S) as line:
            return _exchange(line, name)
    except (OSError, ValueError, ControllerError):
        return None


def door_path(port: int) -> Path:
    """Return the path of the operator's socket for a port. Raises ConfigError: there is no runtime directory."""
    return runtime_dir() / f"waldo-{port}"


def ask_operator_door(port: int, act: str) -> str:
    """Send an operator's request to the controller on this computer's `port`; return the controller's report.

    Raises:
        ControllerError: no controller serves the port, or it refused the request.
    """
    with socket.socket(socket.AF_UNIX) as line:
        line.settimeout(_OPERATOR_S)
        try:
            line.connect(str(door_path(port)))
            return str(_exchange(line, act))
        except OSError as error:
            raise ControllerError(
                f"no controller of yours serves port {port} on this computer ({error}); start it first: "
                "yam-waldo --hardware --channel …"
            ) from error


def _exchange(line: socket.socket, name: str) -> Any:
    line.sendall(encode({"do": name, "with": {}}))
    with line.makefile("rb") as answers:
        return result_of(name, answers.readline(MOST_BYTES))


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be sent")
