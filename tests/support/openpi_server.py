"""A small server that speaks openpi's protocol, for the tests; as a process of its own it waves the arms.

    python -m tests.support.openpi_server --log FILE

writes a line of JSON per connection and request into FILE, the first with its port, and answers with chunks that
raise and turn both arms in small sines.
"""

import argparse
import contextlib
import json
import math
import socket
import threading
import time
from pathlib import Path

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.sync.server import serve

from lerobot_robot_yam.face.openpi.messages import decode_message, encode_message

TRACEBACK = "Traceback (most recent call last):\n  ...\nKeyError: 'observation/image'\n"


class OpenpiServer:
    """Behaves as openpi's `WebsocketPolicyServer`, in threads.

    Args:
        answer: makes an answer out of an observation and the number of questions before it: a dictionary; text is sent
            like openpi's tracebacks; bytes are sent as they are; None is no answer at all.
        metadata: the greeting; bytes and text as they are.
        api_key: turns everybody else away.
    """

    def __init__(self, answer, metadata=None, api_key=None, port=0):
        self.answer = answer
        self.metadata = {} if metadata is None else metadata
        self.api_key = api_key
        self.observations = []
        self.connections = 0
        self._server = serve(
            self._serve, "127.0.0.1", port, compression=None, max_size=None, process_request=self._authorise
        )
        self.port = self._server.socket.getsockname()[1]
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._over = threading.Event()
        self._open = set()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.hang_up()
        self._over.set()
        self._server.shutdown()
        self._thread.join()

    def hang_up(self):
        """Close every connection without a word, as a server that dies."""
        for connection in list(self._open):
            with contextlib.suppress(OSError):  # its client was quicker
                connection.socket.shutdown(socket.SHUT_RDWR)

    def wait(self):
        """Serve until killed."""
        self._thread.join()

    def _authorise(self, connection, request):
        if self.api_key and request.headers.get("Authorization") != f"Api-Key {self.api_key}":
            return connection.respond(401, "no\n")
        return None

    def _serve(self, connection):
        self.connections += 1
        self._open.add(connection)
        try:
            connection.send(self._bytes(self.metadata))
            while True:
                self.observations.append(decode_message(connection.recv()))
                answer = self.answer(self.observations[-1], len(self.observations) - 1)
                if answer is None:
                    self._over.wait()
                    return
                if isinstance(answer, str):
                    connection.send(answer)
                    connection.close(CloseCode.INTERNAL_ERROR, "Internal server error.")
                    return
                connection.send(self._bytes(answer))
        except ConnectionClosed:
            pass
        finally:
            self._open.discard(connection)

    @staticmethod
    def _bytes(message):
        return encode_message(message) if isinstance(message, dict) else message


def zeros(steps=4, width=14, dtype=np.float64):
    return {"actions": np.zeros((steps, width), dtype=dtype)}


def counting(observation, number):
    """A chunk whose actions say which one of which chunk they are, in thousandths."""
    width = len(observation["observation/state"])
    return {"actions": np.tile(((number * 100 + np.arange(4)) / 1000.0)[:, None], (1, width))}


def answering(answer):
    return lambda observation, number: answer


STEPS, PERIOD_STEPS = 8, 45
RAISE_RAD, TURN_RAD = 0.3, 0.15


def wave(observation, number):
    """Both arms up and down and from side to side, from the rest pose and back to it; grippers stay.

    A chunk begins where the last one ended: each is executed to its end.
    """
    phase = 2 * math.pi * (number * STEPS + np.arange(STEPS)) / PERIOD_STEPS
    actions = np.tile(np.asarray(observation["observation/state"], dtype=np.float64), (STEPS, 1))
    for first in (0, 7):
        actions[:, first : first + 6] = 0.0
        actions[:, first] = TURN_RAD * np.sin(phase)
        actions[:, first + 1] = actions[:, first + 2] = RAISE_RAD * (1 - np.cos(phase))
    return {"actions": actions, "server_timing": {"infer_ms": 1.0}}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--silent-after", type=int, default=None, help="questions that are answered")
    options = parser.parse_args()
    with open(options.log, "w", buffering=1) as log:

        def note(**fields):
            log.write(json.dumps({"monotonic_s": time.monotonic(), **fields}) + "\n")

        def answer(observation, number):
            state = observation["observation/state"].tolist()
            keys = {key: list(getattr(value, "shape", [])) for key, value in observation.items()}
            note(number=number, state=state, keys=keys, prompt=observation.get("prompt"))
            silent = options.silent_after is not None and number >= options.silent_after
            return None if silent else wave(observation, number)

        metadata = {"angle_unit": "rad", "action_space": "joint_position", "action_horizon": STEPS}
        with OpenpiServer(answer, metadata) as server:
            note(port=server.port)
            server.wait()


if __name__ == "__main__":
    main()
