"""yam-cameras through its command line, on trees laid out as sysfs and /dev are, and on librealsense's own software."""

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from lerobot_robot_yam.commands.cameras import main
from tests.support.plugged_cameras import HEIGHT, SERIAL, WIDTH, Tree
from tests.support.software_realsense import SERIAL as LABEL
from tests.support.software_realsense import Bus, SoftwareRealSense
from tests.support.terminal import Terminal

SIZE = [f"--width={WIDTH}", f"--height={HEIGHT}"]
LENGTH = 40  # pictures of a video
CONFIG = """\
robot:
  type: bi_yam_follower   # mine
  cameras:
    top: {type: intelrealsense, serial_number_or_name: "1"}   # over the table
"""


@pytest.fixture
def tree(tmp_path):
    return Tree(tmp_path / "computer")


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "record.yaml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def realsense(monkeypatch):
    """A D405 of librealsense's software."""
    rs = pytest.importorskip("pyrealsense2", reason="pyrealsense2 cannot be loaded", exc_type=ImportError)
    bus = Bus()
    monkeypatch.setattr(rs, "context", bus)
    bus.plugged.append(SoftwareRealSense(rs))
    yield bus.plugged[0]
    bus.plugged.pop().close()


def run(capsys, *arguments):
    """Exit status, standard output, standard error."""
    status = main(list(map(str, arguments)))
    return status, *capsys.readouterr()


def put_video(path, grey):
    """A video file in the place of a node."""
    scratch = path.with_suffix(".avi")
    writer = cv2.VideoWriter(str(scratch), cv2.VideoWriter.fourcc(*"MJPG"), 30, (WIDTH, HEIGHT))
    for _ in range(LENGTH):
        writer.write(np.full((HEIGHT, WIDTH, 3), grey, np.uint8))
    writer.release()
    shutil.move(scratch, path)


def test_list_shows_serial_model_link_and_nodes(capsys, tree):
    tree.realsense("video0", "2-1")
    tree.realsense("video2", "1-2", serial="7", number="435I", speed="480")
    tree.webcam("video4", "1-3")
    status, out, err = run(capsys, "list", "--root", tree.root)
    rows = [line.split() for line in out.splitlines()[1:]]
    assert status == 0 and sorted(rows) == [
        ["200901010001", "Webcam", "C270", "1-3", "USB", "2", "video4"],
        ["7", "D435i", "1-2", "USB", "2", "video2"],
        [SERIAL, "D405", "2-1", "USB", "3", "video0"],
    ]
    assert err == "D435i 7 (USB 1-2): USB 2 is too slow for a RealSense; use a USB 3 port (blue) with a USB 3 cable\n"


def test_without_cameras_each_action_says_so(capsys, tree, tmp_path):
    for arguments, status in ((["list"], 0), (["preview", tmp_path / "a.png"], 1), (["name"], 1)):
        found, _, err = run(capsys, *arguments, "--root", tree.root)
        assert found == status and "there is no camera; plug one in" in err


def test_formats(capsys, tree, realsense):
    status, out, _ = run(capsys, "list", "--formats")
    assert status == 0 and f"D405 {LABEL}: {WIDTH}x{HEIGHT} at 30 fps\n" in out
    tree.webcam("video4", "1-3")
    assert (
        "Webcam C270 200901010001 (USB 1-3): tells no formats\n"
        in run(capsys, "list", "--formats", "--root", tree.root)[1]
    )


def test_preview_shows_each_camera_and_says_which_fails(capsys, tree, tmp_path):
    sheet = tmp_path / "sheet.png"
    tree.realsense("video0", "2-1")
    put_video(tree.root / "dev/video0", 128)
    status, _, err = run(capsys, "preview", sheet, "--root", tree.root, *SIZE)
    assert status == 0 and f"D405 {SERIAL}: brightness 0.50, 0.0% clipped" in err
    tree.webcam("video2", "1-3")
    put_video(tree.root / "dev/video2", 250)
    tree.webcam("video4", "1-4", serial="3", product="Broken")
    status, _, err = run(capsys, "preview", sheet, "--root", tree.root, *SIZE)
    assert status == 1 and "Broken 3: Broken 3 (USB 1-4) cannot be opened: no process of yours has it open" in err
    pixels = cv2.imread(str(sheet))
    fields = [pixels[180, 240], pixels[180, 720], pixels[404 + 180, 240]]  # two columns
    assert sorted(int(field[0]) for field in fields) == pytest.approx([40, 128, 250], abs=3)


def test_tune_finds_the_exposure_and_writes_it(capsys, realsense, tmp_path, config):
    sheet = tmp_path / "before_after.png"
    assert run(capsys, "name", f"top={LABEL}", f"--config={config}", "--yes", *SIZE)[0] == 0
    status, out, err = run(capsys, "tune", "top", f"--sheet={sheet}", f"--config={config}", "--yes", *SIZE)
    assert status == 0, err
    exposure = int(out.removeprefix("exposure: "))
    assert 0.41 * 4000 / 0.75 < exposure < 0.49 * 4000 / 0.75  # it gives 0.75 of full brightness at 4000 µs
    assert "before: brightness 0.75, 50.0% clipped" in err and ", 0.0% clipped" in err.rpartition("after: ")[2]
    camera = yaml.safe_load(config.read_text())["robot"]["cameras"]["top"]
    assert camera["exposure"] == exposure == realsense.option("exposure") and camera["serial_number_or_name"] == LABEL
    assert cv2.imread(str(sheet)).shape == (404, 960, 3)
    assert "# over the table" in config.read_text()


def test_tune_says_what_it_cannot(capsys, tree, realsense, config):
    status, _, err = run(capsys, "tune", LABEL, f"--config={config}", *SIZE)
    assert status == 1 and f"names no camera {LABEL}: `yam-cameras name` writes it there" in err
    assert run(capsys, "tune", LABEL, "--target=2")[0] == 1
    assert "say which camera, by its serial number; there are: none" in run(capsys, "tune", "--root", tree.root)[2]
    assert f"does not offer color 640x480 at 30 fps; it offers {WIDTH}x{HEIGHT}" in run(capsys, "tune", LABEL)[2]
    tree.realsense("video0", "2-1")
    put_video(tree.root / "dev/video0", 128)
    status, _, err = run(capsys, "tune", "D405", "--root", tree.root, *SIZE)
    assert status == 1 and "offers no exposure over UVC: leave exposure out, or read it with librealsense" in err


def test_name_writes_roles_and_keeps_the_file(capsys, tree, config):
    tree.realsense("video0", "2-1")
    tree.webcam("video4", "1-3")
    tree.webcam("video6", "1-4")
    before = config.read_text()
    pair = [f"wrist_left={SERIAL}", f"--config={config}", "--root", tree.root]
    status, _, err = run(capsys, "name", *pair, "--dry-run")
    assert status == 0 and "+    wrist_left: {type: yam_realsense" in err and config.read_text() == before
    status, _, err = run(capsys, "name", *pair)
    assert status == 1 and "there is no terminal to confirm at" in err and config.read_text() == before
    assert run(capsys, "name", *pair, "--yes")[0] == 0
    text = config.read_text()
    added = f"wrist_left: {{type: yam_realsense, serial_number_or_name: '{SERIAL}', root: {tree.root}, "
    assert text.replace(f"{added}width: 640, height: 480, fps: 30}}\n    ", "") == before
    status, _, err = run(capsys, "name", *pair, "--yes")
    assert status == 0 and "nothing to change" in err and config.read_text() == text
    status, _, err = run(capsys, "name", "top=200901010001", f"--config={config}", "--root", tree.root)
    assert status == 1 and "2 cameras have the serial number" in err
    for wrong in ("top", "to p=1", "=1"):
        status, _, err = run(capsys, "name", wrong, f"--config={config}", "--root", tree.root)
        assert status == 1 and "give a role" in err
    config.write_text("robot: [")
    assert "the file is no YAML" in run(capsys, "name", *pair)[2]


def test_a_person_gives_roles_at_a_terminal(tree, tmp_path):
    tree.realsense("video0", "2-1")
    tree.webcam("video4", "1-3")
    tree.webcam("video6", "1-4")  # the same serial number: it goes by its port
    program = Path(sys.executable).parent / "yam-cameras"
    config = tmp_path / "new.yaml"
    with Terminal(tmp_path, program, "name", f"--config={config}", "--root", tree.root) as terminal:
        terminal.answer(
            ("(USB 2-1) (Enter skips it):", b"top\n"),
            ("(USB 1-3) (Enter skips it):", b"top\n"),
            ("that is taken", b"side\n"),
            ("(USB 1-4) (Enter skips it):", b"\n"),
            ("Make this change? [Y/n]", b"\n"),
        )
        assert terminal.end() == 0
    cameras = yaml.safe_load(config.read_text())["cameras"]
    assert cameras["top"]["serial_number_or_name"] == SERIAL and cameras["top"]["root"] == str(tree.root)
    assert cameras["side"]["type"] == "opencv" and "by-path" in cameras["side"]["index_or_path"]
