"""An arm of the virtual rig is moved in a real browser: by slider, by its tool, against itself; control; a closed tab.

YAM_DOCS_PICTURE=docs/view_move.png has the test write the picture of the page there.
"""

import contextlib
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.state.modes import Mode
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
GRASPED_M = 0.09  # from the tool to where the mouse takes its arrow


class Station:
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
def station(rig, tmp_path):
    station = Station(rig, tmp_path)
    thread = threading.Thread(target=station.run)
    thread.start()
    yield station
    station.stop()
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


def on_screen(station, tab, point):
    """Where a point (3,) m of the scene is on the page, in pixels."""
    (client,) = station.page.server.get_clients().values()
    camera, box = client.camera, tab.locator("canvas").first.bounding_box()
    forward = np.subtract(camera.look_at, camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up_direction)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    ray = point - np.array(camera.position)
    scale = box["height"] / 2 / np.tan(camera.fov / 2) / (ray @ forward)
    return box["x"] + box["width"] / 2 + scale * (ray @ right), box["y"] + box["height"] / 2 - scale * (ray @ up)


def take_control(station, tab, rig):
    rig.set_pose(ARM, q=RAISED)
    tab.get_by_role("button", name="connect …").click()
    tab.get_by_text("HAZARD").wait_for()
    rig.set_pose(ARM, q=RAISED)
    tab.get_by_role("button", name="energise", exact=True).click()
    wait(tab, lambda: station.driver.desk.stage is Stage.ENABLED)
    tab.get_by_role("button", name="take control").click()
    wait(tab, lambda: station.driver.desk.stage is Stage.CONTROL)


def test_an_arm_is_moved_by_slider_and_by_its_tool(station, rig, tmp_path):
    errors = []
    with browser_page(station.page.url, errors, *SIZE) as tab:
        tab.get_by_text("WATCHING").wait_for()
        slide(tab, "joint_1, rad", 0.4)
        tab.get_by_text("the arms are not connected").first.wait_for()
        take_control(station, tab, rig)
        slide(tab, "joint_1, rad", 0.4)
        wait(tab, lambda: abs(station.state.q[0] - 0.4) < 0.02)

        kinematics = YamKinematics("yam", "linear_4310")
        base_m, _ = station.parts[0].place_of(station.driver.session.key(ARM))
        before = kinematics.fk(station.state.setpoint_q)
        along = before[:3, 0]  # the way of the first arrow
        grasped = base_m + before[:3, 3] + GRASPED_M * along
        tab.mouse.move(*on_screen(station, tab, grasped))
        tab.wait_for_timeout(500)
        tab.mouse.down()
        tab.mouse.move(*on_screen(station, tab, grasped + 0.05 * along), steps=5)
        wait(tab, lambda: station.state.mode is Mode.TRACK)
        take_picture(tab, tmp_path)
        tab.mouse.up()
        wait(tab, lambda: station.state.mode is Mode.HOLD)
        moved = kinematics.fk(station.state.q)[:3, 3] - before[:3, 3]
        assert moved @ along > 0.02 and np.linalg.norm(np.cross(moved, along)) < 0.01
    assert not errors


def test_an_arm_is_held_back_from_itself_and_the_page_says_why(station, rig):
    errors = []
    with browser_page(station.page.url, errors, *SIZE) as tab:
        take_control(station, tab, rig)
        slide(tab, "joint_5, rad", 1.57)
        tab.get_by_text(f"held back: {ARM} link3 – {ARM} gripper").first.wait_for()
        wait(tab, lambda: station.state.mode is Mode.HOLD)
        assert 1.0 < station.state.q[4] < 1.32
    assert not errors


def test_control_is_handed_over_and_a_closed_tab_lets_the_arm_hold(station, rig):
    errors = []
    with browser_page(station.page.url, errors, *SIZE) as tab:
        take_control(station, tab, rig)
        first = station.driver.desk.holder
        other = tab.context.new_page()
        other.goto(station.page.url)
        other.get_by_role("button", name="take control").click()
        tab.get_by_text("asks for control").first.wait_for()
        tab.get_by_role("button", name="give control").click()
        wait(tab, lambda: station.driver.desk.holder not in (None, first))
        other.bring_to_front()
        slide(other, "joint_1, rad", 2.5)
        wait(other, lambda: station.state.q[0] > 0.2)
        other.close()
        wait(tab, lambda: station.driver.desk.holder is None, 2.0)
        wait(tab, lambda: station.state.mode is Mode.HOLD, 2.0)
        assert station.state.setpoint_q[0] < 2.3
        tab.get_by_text("is lost: they hold").first.wait_for()
    assert not errors


def take_picture(tab, directory):
    path = Path(os.environ.get("YAM_DOCS_PICTURE") or directory / "page.png")
    tab.screenshot(path=path)
    assert np.asarray(Image.open(path).convert("L")).std() > 10.0
