"""Which messages of a browser reach viser: kinds, fields, numbers, and values of controls."""

import math
from dataclasses import dataclass, field

import msgspec
import pytest

from lerobot_robot_yam.viewer.serving.incoming import MalformedError, passes, settable
from lerobot_robot_yam.viewer.serving.page import Page

NAN, INF = math.nan, math.inf
GIZMO = {"type": "TransformControlsUpdateMessage", "name": "/tool", "wxyz": [1, 0, 0, 0], "position": [0.1, 0, 0.2]}
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0, 0, 0],
    "position": [1, 2, 3],
    "fov": 0.8,
    "near": 0.01,
    "far": 1000,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}


@dataclass
class Controls:
    """One control of each kind on a page."""

    page: Page
    by_name: dict = field(default_factory=dict)

    def __post_init__(self):
        gui = self.page.server.gui
        self.by_name = {
            "button": gui.add_button("button"),
            "checkbox": gui.add_checkbox("checkbox", False),
            "text": gui.add_text("text", ""),
            "dropdown": gui.add_dropdown("dropdown", ("a", "b")),
            "group": gui.add_button_group("group", ("a", "b")),
            "slider": gui.add_slider("slider", -1.0, 1.0, 0.1, 0.0),
            "whole": gui.add_slider("whole", 0, 10, 1, 5),
            "number": gui.add_number("number", 0.0),
            "bounded": gui.add_number("bounded", 0.0, min=0.0),
            "pair": gui.add_multi_slider("pair", 0.0, 1.0, 0.1, (0.2, 0.8)),
            "vector": gui.add_vector3("vector", (0.0, 0.0, 0.0), min=(0.0, 0.0, -1.0), max=(1.0, 1.0, 1.0)),
            "free": gui.add_vector2("free", (0.0, 0.0)),
            "colour": gui.add_rgb("colour", (1, 2, 3)),
            "upload": gui.add_upload_button("upload"),
            "progress": gui.add_progress_bar(0.0),
            "hidden": gui.add_button("hidden", visible=False),
            "disabled": gui.add_slider("disabled", 0.0, 1.0, 0.1, 0.0, disabled=True),
        }

    def find(self, uuid):
        return self.page.server.gui._gui_input_handle_from_uuid.get(uuid)


@pytest.fixture(scope="module")
def controls():
    page = Page(port=0)
    yield Controls(page)
    page.close()


def passed(fields, find=lambda _: None):
    return passes(msgspec.msgpack.encode(fields), find)


@pytest.mark.parametrize(
    "name, value, fits",
    [
        ("button", True, True),
        ("button", "x", False),
        ("checkbox", False, True),
        ("checkbox", 1, False),
        ("text", "pick the cube", True),
        ("text", None, False),
        ("text", ["a"], False),
        ("dropdown", "b", True),
        ("dropdown", "c", False),
        ("dropdown", ["a"], False),
        ("group", "a", True),
        ("group", 0, False),
        ("slider", 0.5, True),
        ("slider", 1, True),
        ("slider", 1.0000000000000002, True),  # steps that a browser has added up
        ("slider", 1.01, False),
        ("slider", NAN, False),
        ("slider", -INF, False),
        ("slider", "nan", False),
        ("slider", "0.5", False),
        ("slider", True, False),
        ("slider", [0.5], False),
        ("slider", {}, False),
        ("whole", 11, False),
        ("whole", 10, True),
        ("number", 1e300, True),
        ("number", 10**30, True),
        ("number", INF, False),
        ("bounded", -0.1, False),
        ("bounded", 1e9, True),
        ("pair", [0.1, 0.9], True),
        ("pair", [0.1], False),
        ("pair", [0.1, 0.2, 0.3], False),
        ("pair", [0.1, NAN], False),
        ("pair", 0.1, False),
        ("vector", [0.5, 0.5, -0.5], True),
        ("vector", [0.5, -0.5, 0.5], False),
        ("vector", ["0", 0, 0], False),
        ("free", [1e6, -1e6], True),
        ("free", [[], []], False),
        ("colour", [0, 255, 3], True),
        ("colour", [0, 256, 3], False),
        ("upload", {"name": "x"}, False),
        ("progress", 1.0, False),
        ("hidden", True, False),
        ("disabled", 0.5, False),
    ],
)
def test_values_of_controls(controls, name, value, fits):
    assert settable(controls.by_name[name], value) == fits


def test_a_control_in_a_hidden_folder(controls):
    gui = controls.page.server.gui
    with gui.add_folder("outer") as outer, gui.add_folder("inner"):
        button = gui.add_button("within")
    assert settable(button, True)
    outer.visible = False
    assert not settable(button, True)
    outer.visible = True
    assert settable(button, True)


def update(control, **updates):
    return {"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": updates}


def test_a_message_sets_nothing_but_values(controls):
    button = controls.by_name["button"]
    assert passed(update(button, value=True), controls.find)
    for name, value in {"removed": True, "update_cb": [], "sync_cb": None, "is_button": False, "props": {}}.items():
        assert not passed(update(button, **{name: value}), controls.find)
        assert not passed(update(button, value=True, **{name: value}), controls.find)
    assert not passed(update(button), controls.find)
    assert not passed(update(button, value=True))  # no such control
    hold = {"type": "GuiButtonHoldMessage", "uuid": button._impl.uuid, "frequency": 10}
    assert passed(hold, controls.find) and not passed(hold | {"frequency": NAN}, controls.find)


@pytest.mark.parametrize(
    "fields, outcome",
    [
        (GIZMO, True),
        (GIZMO | {"owner": ""}, True),
        (GIZMO | {"position": [NAN, 0, 0]}, False),
        (GIZMO | {"position": [1e300, 0, 0]}, False),
        (GIZMO | {"wxyz": [0, 0, 0, 0]}, False),
        (GIZMO | {"wxyz": [INF, 0, 0, 0]}, False),
        (GIZMO | {"position": [0, 0]}, MalformedError),
        (GIZMO | {"position": "xyz"}, MalformedError),
        (GIZMO | {"name": 3}, MalformedError),
        (GIZMO | {"more": 3}, MalformedError),
        (CAMERA, True),
        (CAMERA | {"fov": NAN}, False),
        (CAMERA | {"image_width": 0.5}, MalformedError),
        ({key: value for key, value in CAMERA.items() if key != "far"}, MalformedError),
        ({"type": "ShareUrlRequest"}, False),
        ({"type": "ShareUrlDisconnect"}, False),
        ({"type": "GuiFormDirtyMessage", "uuid": "x"}, False),
        ({"type": "FileTransferStartUpload", "part_count": 10**9}, False),
        ({"type": "FileTransferPart", "content": bytes(1000)}, False),
        ({"type": "GetRenderResponseMessage"}, False),
        ({"type": "RunJavascriptMessage", "source": "alert()"}, False),
        ({"type": "NoSuchMessage"}, MalformedError),
        ({"type": ["GuiUpdateMessage"]}, MalformedError),
        ({"type": "GuiUpdateMessage", "uuid": [], "updates": {}}, MalformedError),
        ({"type": "GuiUpdateMessage", "uuid": "x", "updates": []}, MalformedError),
        ({}, MalformedError),
        ([], MalformedError),
        (3, MalformedError),
        ({1: 2}, MalformedError),
    ],
)
def test_kinds_and_fields(fields, outcome):
    if outcome is MalformedError:
        with pytest.raises(MalformedError):
            passed(fields)
    else:
        assert passed(fields) is outcome


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"\xc1",
        b"\xff" * 100,
        b"\xdd\xff\xff\xff\xff",  # an array of 4 billion, it says
        b"\xdf\xff\xff\xff\xff\xa1a",
        b"\x91" * 60_000 + b"\x01",  # nested
        b"\x81\xa4type\xa2\xff\xfe",  # no UTF-8
        b"\x81\x80\x01",  # a key that is a map
        b"\xd6\xff\xff\xff\xff\xff",  # a time
        msgspec.msgpack.encode(CAMERA)[:-3],
        msgspec.msgpack.encode(CAMERA) + b"\x00",
        '{"type": "ViewerCameraMessage"}',
        "",
    ],
)
def test_garbage(raw):
    with pytest.raises(MalformedError):
        passes(raw, lambda _: None)
