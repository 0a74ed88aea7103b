"""Deflections, the usual map, and files that are no map of the pad."""

import json
from dataclasses import dataclass

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.pad_map import AxisUse, PadMap, load_map
from lerobot_robot_yam.face.driving.sdl_pads import Reading


@dataclass
class StillPad:
    """A pad that nobody touches."""

    known: bool = True
    name: str = "Pad"
    guid: str = "0"

    def read(self):
        return Reading((0.0,) * 6, (False,) * 15)

    def close(self):
        pass


def test_a_deflection_is_a_share_of_each_sides_way():
    use = AxisUse(axis=0, rest=0.1, positive=-0.9, negative=0.6)
    assert [use.deflection(value) for value in (0.1, -0.4, -0.9, -1.0, 0.35, 0.6, 1.0)] == pytest.approx(
        [0.0, 0.5, 1.0, 1.0, -0.5, -1.0, -1.0]
    )


def test_the_usual_map_drives_as_the_vendors_pad(tmp_path):
    """x: minus axis 1, y: minus axis 0, theta: minus axis 2, rail: minus axis 3."""
    found = load_map(StillPad(), tmp_path / "none.json")
    reading = Reading((0.1, 0.2, 0.3, 0.4, 0.0, 0.0), (False,) * 15)
    assert found.deflections(reading) == pytest.approx({"x": -0.2, "y": -0.1, "theta": -0.3, "height": -0.4})
    assert len(set(found.buttons.values())) == len(found.buttons) == 5


def test_a_map_is_kept(tmp_path):
    path = tmp_path / "yam" / "pad.json"
    axes = {name: AxisUse(number, 0.0, 1.0, -1.0) for number, name in enumerate(("theta", "x", "y"))}
    PadMap(axes, {"stop": 7}).save(StillPad(), path)
    assert load_map(StillPad(known=False), path) == PadMap(axes, {"stop": 7})


def test_an_unknown_pad_needs_a_map(tmp_path):
    with pytest.raises(ConfigError, match="calibrate it: lerobot-calibrate --teleop.type=yam_gamepad"):
        load_map(StillPad(known=False), tmp_path / "none.json")


GOOD = {
    "version": 1,
    "axes": {name: {"axis": n, "rest": 0.0, "positive": 1.0, "negative": -1.0} for n, name in enumerate(("x", "y"))},
    "buttons": {"stop": 0},
}
GOOD["axes"]["theta"] = {"axis": 2, "rest": 0.0, "positive": 1.0, "negative": -1.0}


def with_x(**changes):
    return {**GOOD, "axes": {**GOOD["axes"], "x": {**GOOD["axes"]["x"], **changes}}}


@pytest.mark.parametrize(
    ("data", "why"),
    [
        ("{", "Expecting"),
        ([], "list indices"),
        (GOOD | {"version": 2}, "version 2"),
        (GOOD | {"buttons": {}}, "incomplete"),
        (GOOD | {"buttons": {"stop": 15}}, "no button 15"),
        (with_x(axis=6), "no axis 6"),
        (with_x(rest=float("nan")), "hardly moves"),
        (with_x(negative=0.1), "hardly moves"),
        (with_x(negative=0.5), "one side only"),
        (with_x(rest="0"), "unsupported operand"),
    ],
    ids=str,
)
def test_a_file_that_is_no_map(tmp_path, data, why):
    path = tmp_path / "pad.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    with pytest.raises(ConfigError, match=f"no calibration of this gamepad .*{why}"):
        load_map(StillPad(), path)
