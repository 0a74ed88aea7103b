"""An arm of the virtual rig is moved in a real browser, by slider.

YAM_DOCS_PICTURE=docs/view_move.png has the test write the picture of the page there.
"""

import contextlib
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.moving.control_desk import Stage
from lerobot_robot_yam.viewer.moving.driving_plan import plan_of
from lerobot_robot_yam.viewer.moving.moving import Moving
from lerobot_robot_yam.viewer.serving.page import Page, served
from tests.support.browser import browser_page
from tests.support.rigged import sim_config
from tests.viewer.conftest import ARM, RAISED

pytestmark = [pytest.mark.long, pytest.mark.alone]

SIZE = (900, 700)  # drawn without a graphics card: a larger page answers too seldom


class MovingView:
    """A page that drives an arm, as `yam-view --channel` does, in this process."""

    def __init__(self, rig, directory):
        self.page, self._stopped = Page(port=0), threading.Event()
        live = Live(self.page.server)
        plan = plan_of([sim_config(rig, ARM)], directory / "poses.json")
        self.moving = Moving(self.page.server, plan, live.place_of)
        self.driver = self.moving.driver
        self.parts = [live, self.moving, self]

    def update(self, now_s):
        """Of the page: end it."""
        if self._stopped.is_set():
            raise KeyboardInterrupt

    def run(self):
        with contextlib.suppress(KeyboardInterrupt), served(self.page, self.parts[:2]):
            self.driver.start()
            self.page.run(self.parts)

    def stop(self):
        self._stopped.set()

    @property
    def state(self):
        return self.driver.arms[ARM].client.published()


@pytest.fixture
def rig():
    with running_rig(arms=[ARM]) as rig:
        yield rig


@pytest.fixture
def view(rig, tmp_path):
    view = MovingView(rig, tmp_path)
    thread = threading.Thread(target=view.run)
    thread.start()
    yield view
    view.stop()
    thread.join()


def wait(tab, until, seconds=30.0):
    for _ in range(round(seconds / 0.05)):
        if until():
            return
        tab.wait_for_timeout(50)
    raise AssertionError(tab.locator("body").inner_text()[-2000:])


def slide(tab, label, value):
    """Type a value into the field beside a slider."""
    row = tab.locator("div", has=tab.get_by_text(label, exact=True)).filter(has=tab.locator("input")).last
    field = row.locator("input").last
    field.fill(str(value))
    field.press("Enter")


def take_control(view, tab, rig):
    rig.set_pose(ARM, q=RAISED)
    tab.get_by_role("button", name="connect …").click()
    tab.get_by_text("HAZARD").wait_for()
    rig.set_pose(ARM, q=RAISED)
    tab.get_by_role("button", name="energise", exact=True).click()
    wait(tab, lambda: view.driver.desk.stage is Stage.ENABLED)
    tab.get_by_role("button", name="take control").click()
    wait(tab, lambda: view.driver.desk.stage is Stage.CONTROL)


def test_an_arm_is_moved_by_slider(view, rig, tmp_path):
    errors = []
    with browser_page(view.page.url, errors, *SIZE) as tab:
        tab.get_by_text("WATCHING").wait_for()
        slide(tab, "joint_1, rad", 0.3)
        tab.get_by_text("the arms are not connected").first.wait_for()
        take_control(view, tab, rig)
        slide(tab, "joint_1, rad", 0.4)
        wait(tab, lambda: abs(view.state.q[0] - 0.4) < 0.02)
        take_picture(tab, tmp_path)
    assert not errors


def take_picture(tab, directory):
    path = Path(os.environ.get("YAM_DOCS_PICTURE") or directory / "page.png")
    tab.screenshot(path=path)
    assert np.asarray(Image.open(path).convert("L")).std() > 10.0
