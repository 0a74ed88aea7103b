"""Writing cameras into a run config: the rest of the text stays, whatever its style."""

import difflib

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_robot_yam.cameras.role_names import named_cameras, read_config, with_cameras
from lerobot_robot_yam.errors import ConfigError, SetupError
from tests.support.paths import ROOT

FIELDS = {"type": "yam_realsense", "serial_number_or_name": "0123", "width": 640, "height": 480, "fps": 30}
LINE = "top: {type: yam_realsense, serial_number_or_name: '0123', width: 640, height: 480, fps: 30}"
BLOCK = """\
robot:
  cameras:   # all of them
    # over the table
    top:
      type: yam_realsense
      serial_number_or_name: "1"   # the old one
      rotation: 90
      # turned
    wrist: {type: opencv, index_or_path: 3}
dataset: {}   # last
"""
TEXTS = {
    "nothing": ("", f"cameras:\n  {LINE}\n"),
    "comments": ("# mine", f"# mine\ncameras:\n  {LINE}\n"),
    "other keys": ("a: 1   # k\n", f"a: 1   # k\ncameras:\n  {LINE}\n"),
    "a robot without": ("robot:\n  # t\n  type: x\n", f"robot:\n  # t\n  cameras:\n    {LINE}\n  type: x\n"),
    "empty": ("robot:\n  cameras:\nb: 1\n", f"robot:\n  cameras:\n    {LINE}\nb: 1\n"),
    "empty braces": ("robot: {cameras: {}} # c\n", f"robot: {{cameras: {{{LINE}}}}} # c\n"),
    "braces": ("robot: {cameras: {a: {type: b}}}\n", f"robot: {{cameras: {{{LINE}, a: {{type: b}}}}}}\n"),
    "no robot": ("cameras:\n  top: {type: a}   # c\n", f"cameras:\n  {LINE} # c\n"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_texts_of_all_styles(name):
    before, after = TEXTS[name]
    assert with_cameras(before, {"top": FIELDS}) == after
    assert with_cameras(after, {"top": FIELDS}) == after
    assert named_cameras(after)["top"] == FIELDS


def test_what_a_camera_says_beside_stays_and_so_do_the_comments_around_it():
    after = with_cameras(BLOCK, {"top": {"type": "yam_realsense", "exposure": 900}})
    assert named_cameras(after)["top"] == {
        **{"type": "yam_realsense", "serial_number_or_name": "1", "rotation": 90, "exposure": 900}
    }
    assert all(comment in after for comment in ("# all of them", "# over the table", "# turned", "# last"))
    other = with_cameras(BLOCK, {"wrist": FIELDS})
    assert named_cameras(other)["wrist"] == FIELDS  # of another type: nothing of it stays


@pytest.mark.parametrize("path", sorted(ROOT.glob("configs/*/*record.yaml")), ids=lambda path: path.name)
def test_the_shipped_configs_keep_every_other_line(path):
    before = path.read_text()
    after = with_cameras(before, {"top": FIELDS})
    lost = [line[2:] for line in difflib.ndiff(before.splitlines(), after.splitlines()) if line.startswith("- ")]
    old = yaml.safe_load(before)["robot"].get("cameras", {}).get("top", {})
    assert len(lost) <= 1 + len(old)
    assert yaml.safe_load(after)["robot"]["cameras"]["top"] == FIELDS


@settings(deadline=None, max_examples=30)
@given(st.dictionaries(st.from_regex("[a-z_]{1,8}", fullmatch=True), st.integers() | st.text(max_size=8)))
def test_any_other_keys_stay(values):
    before = yaml.safe_dump({"robot": {**values, "type": "x"}, "z": values})
    config = yaml.safe_load(with_cameras(before, {"top": FIELDS}))
    cameras = config["robot"].pop("cameras")
    assert cameras["top"] == FIELDS and config == {
        **{"robot": {k: v for k, v in {**values, "type": "x"}.items() if k != "cameras"}, "z": values}
    }


@pytest.mark.parametrize(
    "text, words",
    [
        ("robot: [1\n", "the file is no YAML"),
        ("- a\n", "the file is no group of keys"),
        ("robot: 3\n", "robot is no group of keys"),
        ("robot:\n  cameras: &all\n    top: {type: a}\nother: *all\n", "in a way that cannot be changed here"),
    ],
)
def test_texts_that_are_refused(text, words):
    with pytest.raises(ConfigError, match=words):
        with_cameras(text, {"top": FIELDS})


def test_a_file_that_cannot_be_read(tmp_path):
    assert read_config(tmp_path / "none.yaml") == ""
    with pytest.raises(SetupError, match="cannot be read"):
        read_config(tmp_path)
