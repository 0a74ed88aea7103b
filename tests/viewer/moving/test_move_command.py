"""`yam-view` drives an arm of a live rig: what holds and lands when browsers and the page end."""

import re
import signal
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops, save_stops
from lerobot_robot_yam.rig.control import running_rig
from scripts import recorders
from tests.support.browser_socket import BrowserSocket
from tests.support.crooked_arm import STOPS, arguments, scene
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.terminal import Terminal
from tests.support.waiting import wait

pytestmark = [pytest.mark.long, pytest.mark.alone]

HOLDS_S = 0.5
JOINT = "joint_1, rad"


@pytest.fixture
def rig(tmp_path):
    with running_rig(scene=scene(tmp_path, [0.0] * 7)) as rig:
        yield rig


@pytest.fixture
def page(rig, tmp_path):
    """`yam-view` in a terminal, and its port."""
    save_stops("arm", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))
    command = [sys.executable, "-m", "lerobot_robot_yam.commands.pages.view", "--port", "18580"]
    terminal = Terminal(tmp_path, *command, *arguments(rig), "--calibration", "stops.json", cwd=tmp_path)
    terminal.wait_shown("open http://127.0.0.1:")
    terminal.port = int(re.search(r"open http://127.0.0.1:(\d+)", terminal.shown)[1])
    yield terminal
    terminal.close()


@pytest.fixture
def browser(page):
    browser = BrowserSocket(page.port)
    yield browser
    browser.close()


def q1(rig):
    return rig.state()["arms"]["only"]["q"][0]


def enabled(rig):
    return [name for name, motor in rig.state()["arms"]["only"]["motors"].items() if motor["enabled"]]


def take_control(browser):
    browser.press("connect …")
    browser.press("energise")
    wait(lambda: browser.was_told("the arms hold where they are"))
    browser.press("take control")
    wait(lambda: browser.was_told("controls the arms"))


def sweep(rig, browser):
    """Have joint 1 on its way, far from its goal."""
    take_control(browser)
    browser.set("joint_2, rad", 0.6)
    wait(lambda: rig.state()["arms"]["only"]["q"][1] > 0.5)
    browser.set(JOINT, 3.0)
    wait(lambda: q1(rig) > 0.3)


@pytest.mark.parametrize("end", ["closed", "frozen"])
def test_an_arm_on_its_way_holds_when_its_browser_is_lost(rig, browser, end):
    sweep(rig, browser)
    recorders.truth_start(rig, "only", 5.0)
    lost_s = time.monotonic()
    if end == "closed":
        browser.close()
    else:
        browser.alive = False
    time.sleep(2.0)
    truth = recorders.truth(rig, "only")
    moving = truth["stamp_s"][np.abs(truth["dq"][:, 0]) > 0.05]
    assert moving[-1] - lost_s < HOLDS_S + 0.2  # it brakes
    assert len(enabled(rig)) == 7 and q1(rig) < 2.5


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
def test_the_arm_lands_however_the_page_ends(rig, page, browser, number):
    sweep(rig, browser)
    page.kill(number)
    wait(lambda: not enabled(rig), 40.0)
    page.end()
    assert moved_after_cut_m(rig, "only") < MOST_M
