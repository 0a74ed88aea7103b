"""Random messages to the page's socket, beside an arm that holds: no command reaches it, nothing dies.

One thing may come of a random message: the emergency stop, which anybody may press.
"""

import contextlib
import math
import random
import time
import typing

import msgspec
import numpy as np
import pytest
import viser._messages as messages
from viser.infra._messages import get_type_hints_cached, wire_field_names
from websockets.exceptions import ConnectionClosed, InvalidStatus

from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.moving import heartbeat
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support.browser import PATIENT_S
from tests.support.rigged import rig_of, session_on, sim_config
from tests.viewer.serving.test_guarded_server import browser
from tests.viewer.serving.test_incoming import CAMERA, Controls

FOLLOWER = "follower_left"
STILL_RAD = 0.02
KINDS = sorted(messages.Message.get_subclasses(), key=lambda kind: kind.__name__)
ODD_NUMBERS = (0, -1, 1, 0.5, -0.0, math.nan, math.inf, -math.inf, 1e300, 5e-324, 2**63, -(2**63), 255, 1e9)
ODD_TEXTS = (
    "",
    "nan",
    "inf",
    "1e999",
    "0",
    "a",
    "\0",
    "é" * 40,
    "<script>alert()</script>",
    "../../etc/passwd",
    "%s%n",
)
SETTINGS = ("value", "removed", "update_cb", "sync_cb", "is_button", "props", "uuid", "gui_api", "hold_cbs_from_freq")


class Sender:
    """Makes messages up. `known`: names of nodes and ids of controls that there are, with their handles."""

    def __init__(self, seed, known):
        self._rng, self._known, self._names = random.Random(seed), known, list(known)

    def message(self):
        """(message as bytes, whether it may be malformed)."""
        rng = self._rng
        kind = rng.choice(KINDS)
        fields = {name: self._like(get_type_hints_cached(kind)[name], 0) for name in wire_field_names(kind)}
        fields["type"] = kind.__name__
        make = rng.choice(
            ("setting", "setting", "setting", "typed", "typed", "camera", "wrong", "cut", "noise", "huge")
        )
        if make == "setting":
            names = rng.choices(SETTINGS, (20, *[1] * (len(SETTINGS) - 1)), k=rng.choice((1, 1, 1, 2)))
            uuid = rng.choice(self._names)
            value = self._plausible(self._known[uuid])
            updates = {name: value if name == "value" else self._anything(0) for name in names}
            fields = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}
        elif make == "camera":
            fields = dict(CAMERA)
        elif make == "wrong":
            fields[rng.choice(list(fields))] = self._anything(0)
        elif make == "noise":
            return rng.randbytes(rng.randrange(200)), True
        elif make == "huge":
            return msgspec.msgpack.encode(CAMERA | {"more": "x" * rng.choice((100, 10_000, 100_000))}), True
        raw = msgspec.msgpack.encode(fields)
        return raw[: rng.randrange(len(raw))] if make == "cut" else raw, make not in ("setting", "camera")

    def _plausible(self, control):
        """A value like the one that a control has, which may be beyond its limits; or any other."""
        rng, value = self._rng, getattr(control, "value", None)
        if rng.random() < 0.3:
            return self._anything(0)
        if isinstance(value, tuple):
            return [rng.uniform(0.0, 1.2) for _ in value]
        if isinstance(value, bool):
            return rng.choice((True, False))
        return rng.choice(("a", "b", "c")) if isinstance(value, str) else rng.uniform(-1.2, 1.2)

    def _anything(self, depth):
        rng = self._rng
        kinds = ("number", "number", "text", "truth", "nothing", *(("row", "fields") if depth < 3 else ()))
        kind = rng.choice(kinds)
        if kind == "number":
            return rng.choice((*ODD_NUMBERS, rng.uniform(-2.0, 2.0), rng.uniform(0.0, 1.0)))
        if kind == "text":
            return rng.choice((*ODD_TEXTS, *self._names))
        if kind == "row":
            return [self._anything(depth + 1) for _ in range(rng.randrange(5))]
        if kind == "fields":
            return {rng.choice(ODD_TEXTS): self._anything(depth + 1) for _ in range(rng.randrange(3))}
        return rng.choice((True, False)) if kind == "truth" else None

    def _like(self, hint, depth):
        """A value of a type; now and then of another."""
        rng, origin, inner = self._rng, typing.get_origin(hint), typing.get_args(hint)
        if hint is float:
            return rng.choice((*ODD_NUMBERS, rng.uniform(-2.0, 2.0)))
        if hint is int:
            return rng.choice((0, 1, -1, 7, 2**62))
        if hint is bool:
            return rng.choice((True, False))
        if hint is str:
            return rng.choice((*ODD_TEXTS, *self._names, *self._names))
        if origin is typing.Literal:
            return rng.choice(inner)
        if origin is typing.Union:
            return self._like(rng.choice(inner), depth)
        if origin is tuple:
            inner = inner[:1] * rng.randrange(4) if inner[-1:] == (...,) else inner
            return [self._like(each, depth + 1) for each in inner]
        return self._anything(depth)


class Line:
    """A WebSocket that is opened again when it was closed."""

    def __init__(self, page):
        self._page, self._socket = page, None

    def send(self, raw):
        with contextlib.suppress(ConnectionClosed, InvalidStatus, TimeoutError):
            if self._socket is None:
                self._socket = browser(self._page)
                self._socket.send(msgspec.msgpack.encode(CAMERA))  # viser knows a page by its first
            self._socket.send(raw)
            with contextlib.suppress(TimeoutError):
                while True:
                    self._socket.recv(timeout=0)
            return
        self.close()

    def close(self):
        if self._socket is not None:
            self._socket.close()
        self._socket = None


@contextlib.contextmanager
def stopped_in_the_end():
    try:
        yield
    finally:
        EmergencyStop().release()


def noted(controls):
    """(name, value) of every value that a part of the page is told, from now on."""
    values = []
    for name, control in controls.by_name.items():
        if hasattr(control, "on_update"):
            control.on_update(lambda event, name=name: values.append((name, event.target.value)))
    return values


def in_range(name, value):
    if name in ("slider", "whole", "bounded", "number"):
        low, high = {"slider": (-1.0, 1.0), "whole": (0, 10), "bounded": (0, math.inf)}.get(name, (-math.inf, math.inf))
        return math.isfinite(value) and low - 1e-5 <= value <= high + 1e-5
    if name in ("pair", "vector", "free", "colour"):
        return len(value) == {"vector": 3, "colour": 3}.get(name, 2) and all(map(math.isfinite, value))
    return value in ("a", "b") if name == "dropdown" else isinstance(value, (str, bool))


@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=pytest.mark.long)])
def test_random_messages(count, capfd):
    with contextlib.ExitStack() as stack:
        rig = stack.enter_context(rig_of("lockstep", arms=[FOLLOWER]))
        session = session_on(rig, sim_config(rig, FOLLOWER))
        session.start()
        stack.callback(session.discard)
        stack.enter_context(stopped_in_the_end())
        page = stack.enter_context(contextlib.closing(Page(port=0)))
        controls = Controls(page)
        values = noted(controls)
        live = stack.enter_context(contextlib.closing(Live(page.server)))
        live.update(time.monotonic())
        arm = session[FOLLOWER]
        before = arm.observe()
        known = page.server.gui._gui_input_handle_from_uuid | page.server.scene._handle_from_node_name
        sender = Sender(count, known)
        line, other = (stack.enter_context(contextlib.closing(Line(page))) for _ in range(2))
        modes = set()
        for number in range(count):
            raw, malformed = sender.message()
            (other if malformed else line).send(raw)  # the others' connection is closed time and again
            if number % 10 == 0:
                session.clock.sleep(0.01)
                live.update(time.monotonic())
                state = arm.observe()
                modes.add(state.mode)
                assert np.abs(state.q - before.q).max() < STILL_RAD
                assert np.abs(state.setpoint_q - before.setpoint_q).max() < STILL_RAD
        assert modes <= {before.mode, Mode.STOPPED}
        assert len(values) > count / 200 and all(in_range(name, value) for name, value in values)

        EmergencyStop().release()
        session.clock.sleep(0.1)
        line.close()
        uuid = live._stop._button._impl.uuid
        deadline = time.monotonic() + 10
        while not EmergencyStop().latched and time.monotonic() < deadline:
            line.send(msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": True}}))
            time.sleep(0.05)
        session.clock.sleep(0.1)
        assert arm.observe().mode is Mode.STOPPED  # the page still answers
    said = capfd.readouterr()
    assert "Traceback" not in said.err + said.out, said.err


@pytest.mark.long
def test_random_messages_beside_a_browser_that_controls_the_arm(station, monkeypatch):
    for limit in ("SILENT_S", "OLD_S"):
        monkeypatch.setattr(heartbeat, limit, PATIENT_S)  # on a busy machine the flood may cost a browser its control
    controlling = station.browser()
    station.take_control(controlling)
    gui, scene = station.page.server.gui, station.page.server.scene
    sender = Sender(1, gui._gui_input_handle_from_uuid | scene._handle_from_node_name)
    before, holder = station.state.setpoint_q, station.driver.desk.holder
    with contextlib.ExitStack() as stack:
        line, other = (stack.enter_context(contextlib.closing(Line(station.page))) for _ in range(2))
        for number in range(10_000):
            raw, malformed = sender.message()
            (other if malformed else line).send(raw)
            if number % 10 == 0:
                station.round()
                assert station.state.mode is Mode.HOLD and station.driver.desk.holder == holder
                np.testing.assert_array_equal(station.state.setpoint_q, before)
    assert controlling.was_told("asks for control")  # a press that was good: the page has heard them
    controlling.set("joint_1, rad", 0.2)
    station.run(lambda: station.state.q[0] > 0.18)
