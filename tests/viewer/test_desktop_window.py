"""yam-view --desktop as a user runs it, on a screen without a monitor.

YAM_DOCS_PICTURE=docs/view_desktop.png has the test write the picture of the window there.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from PIL import ImageGrab

from lerobot_robot_yam.rig.control import running_rig
from tests.support.browser import keep_picture
from tests.support.rigged import session_on, sim_config, track
from tests.support.waiting import wait

pytestmark = [pytest.mark.long, pytest.mark.alone]

OWN, OTHER = "follower_left", "follower_right"
RAISED = [0.4, 1.1, 1.2, -0.5, 0.0, 0.2]
COLOURS = 1200  # that the two arms have, with light and shade; the sky has 200
WAIT_S = 60.0
SCREEN = "1500x900x24"  # of which the window takes two thirds each way


@contextlib.contextmanager
def virtual_screen(size: str = "640x480x8") -> Iterator[dict[str, str]]:
    """Yields the environment of programs that are to use it; where there is no Xvfb the test is skipped, aloud.

    size: width x height x bits of a pixel.
    """
    if shutil.which("Xvfb") is None:
        pytest.skip("what needs a screen is not tested: there is no Xvfb (Debian: apt install xvfb)")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", size, "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with open(read) as numbers:
            environment = os.environ | {"DISPLAY": f":{numbers.readline().strip()}"}
        for name in ("WAYLAND_DISPLAY", "XDG_SESSION_TYPE"):
            environment.pop(name, None)
        yield environment
    finally:
        server.terminate()
        server.wait()


def window_on(screen):
    """The screen, without the black around the window."""
    seen = ImageGrab.grab(xdisplay=screen["DISPLAY"])
    return seen.crop(seen.getbbox())


def colours(picture):
    return len(picture.getcolors(maxcolors=picture.width * picture.height))


@contextlib.contextmanager
def desktop_window(screen, *options):
    """yam-view --desktop; Ctrl-C ends it. Its last words are in the list that is yielded."""
    command = [sys.executable, "-m", "lerobot_robot_yam.commands.pages.view", "--desktop", *options]
    window, said = subprocess.Popen(command, env=screen, stderr=subprocess.PIPE, text=True), []
    try:
        yield said
    finally:
        window.send_signal(signal.SIGINT)
        said.append(window.communicate(timeout=WAIT_S)[1])
    assert window.returncode == 130 and "Traceback" not in said[0], said


def test_the_window_shows_all_arms_and_lands_its_own(tmp_path):
    with running_rig(arms=[OWN, OTHER]) as rig, virtual_screen(SCREEN) as screen, contextlib.ExitStack() as stack:
        others = session_on(rig, sim_config(rig, OTHER))
        stack.callback(others.stop)
        others.start()
        track(others, {OTHER: RAISED}, 3.0, gripper=0.8)
        own = ["--channel", OWN, "--interface", "yam_sim", "--rig", rig.name, "--gripper", "linear_4310", "--yes"]
        with desktop_window(screen, *own) as said:
            wait(lambda: colours(window_on(screen)) >= COLOURS, WAIT_S)
            keep_picture(window_on(screen), tmp_path)
        assert f"{OWN}: landed" in said[0]
