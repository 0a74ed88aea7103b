"""A browser as the server of the page sees it: a WebSocket that speaks viser's messages."""

import threading
import time

import msgspec.msgpack
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

_PATIENCE_S = 5.0
_CAMERA = {
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [1.0, 1.0, 1.0],
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}


class BrowserSocket:
    """One tab with the page. It answers heartbeats while `alive`.

    Attributes:
        alive: False: its script hangs, and its WebSocket stays open.
        stalled: True: the network keeps what it sends, and delivers it, in order, when this is False again.
        notices: words of the notifications that it was shown.
    """

    def __init__(self, port):
        self.alive = True
        self._kept = None
        self._sending = threading.Lock()
        self.notices = []
        self._elements = {}  # by uuid: the message that made it, with the newest properties
        self._changed = threading.Condition()
        self._socket = connect(
            f"ws://127.0.0.1:{port}",
            origin=f"http://127.0.0.1:{port}",
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
            compression=None,
        )
        self._thread = threading.Thread(target=self._read, name="browser-socket")
        self._thread.start()
        self.send("ViewerCameraMessage", **_CAMERA)  # from then on it counts as a client

    def close(self):
        """Close the tab."""
        self._socket.close()
        self._thread.join()

    @property
    def stalled(self):
        return self._kept is not None

    @stalled.setter
    def stalled(self, stalled):
        with self._sending:
            for message in self._kept or ():
                self._socket.send(message)
            self._kept = [] if stalled else None

    def send(self, kind, **fields):
        """Any message."""
        message = msgspec.msgpack.encode({"type": kind, **fields})
        with self._sending:
            if self._kept is None:
                self._socket.send(message)
            else:
                self._kept.append(message)

    def press(self, label):
        """A button of the page, or of a question."""
        self.send("GuiUpdateMessage", uuid=self._uuid(label), updates={"value": True})

    def hold(self, label):
        """A button of a base, held down: one of the messages that a browser then sends 20 times a second."""
        self.send("GuiButtonHoldMessage", uuid=self._uuid(label), frequency=20.0)

    def set(self, label, value):
        """A slider, number, text or list."""
        self.send("GuiUpdateMessage", uuid=self._uuid(label), updates={"value": value})

    def value(self, label):
        """What a control shows."""
        return self._elements[self._uuid(label)]["value"]

    def shows(self, words):
        """Whether some text of the page has these words in it."""
        return any(words in str(made["props"].get("content", "")) for made in list(self._elements.values()))

    def drag_tool(self, arm, position, wxyz):
        """The arrows at a tool, to a pose in the frame of the arm's base."""
        self.send(
            "TransformControlsUpdateMessage",
            name=f"/moving/{arm}/tool",
            position=[float(value) for value in position],
            wxyz=[float(value) for value in wxyz],
        )

    def was_told(self, words):
        """Whether a notice had these words in it."""
        return any(words in notice for notice in list(self.notices))

    def labels(self):
        """Of all controls that are on the page."""
        return {made["props"].get("label") for made in list(self._elements.values())}

    def _uuid(self, label):
        deadline = time.monotonic() + _PATIENCE_S
        with self._changed:
            while True:
                found = [uuid for uuid, made in self._elements.items() if made["props"].get("label") == label]
                if found:
                    return found[-1]
                assert self._changed.wait(deadline - time.monotonic()), f"no {label!r} among {self.labels()}"

    def _read(self):
        try:
            for packet in self._socket:
                length = int.from_bytes(packet[8:16], "little")
                content = zstandard.ZstdDecompressor().decompress(packet[16 : 16 + length])
                for message in msgspec.msgpack.decode(content)["messages"]:
                    self._take(message)
        except ConnectionClosed:
            pass

    def _take(self, message):
        kind = message["type"]
        if kind == "LocalStorageGetItemRequestMessage" and self.alive:
            uuid = message["request_uuid"]
            self.send("LocalStorageGetItemResponseMessage", value=None, error=None, request_uuid=uuid)
        elif kind == "NotificationShowMessage":
            self.notices.append(message["props"]["body"])
        with self._changed:
            if kind == "GuiRemoveMessage":
                self._elements.pop(message["uuid"], None)
            elif kind == "GuiUpdateMessage":
                made = self._elements.get(message["uuid"])
                if made is not None:
                    made["props"] = {**made["props"], **message["updates"]}
                    made.update({key: value for key, value in message["updates"].items() if key == "value"})
            elif "uuid" in message and "props" in message:
                self._elements[message["uuid"]] = message
            self._changed.notify_all()
