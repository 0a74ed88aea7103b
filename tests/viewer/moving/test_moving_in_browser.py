"""An arm of the virtual rig is moved in a real browser: by slider and by mouse.

YAM_DOCS_PICTURE=docs/view_move.png has the test write the picture of the page there.
"""

import contextlib
import threading

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics, pose_errors
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.moving import heartbeat
from lerobot_robot_yam.viewer.moving.control_desk import Stage
from lerobot_robot_yam.viewer.moving.driving_plan import plan_of
from lerobot_robot_yam.viewer.moving.moving import Moving
from lerobot_robot_yam.viewer.serving.page import Page, served
from tests.support.browser import PATIENT_S, browser_page, take_picture
from tests.support.rigged import sim_config
from tests.viewer.conftest import ARM, RAISED

pytestmark = [pytest.mark.long, pytest.mark.alone]

JOINT = "joint_1, rad"
SIZE = (900, 700)


class MovingView:
    """A page that drives an arm, as `yam-view --channel` does, in this process."""

    def __init__(self, rig, directory):
        self.page, self._stopped = Page(port=0), threading.Event()
        self.live = Live(self.page.server)
        plan = plan_of([sim_config(rig, ARM)], directory / "poses.json")
        self.moving = Moving(self.page.server, plan, self.live.place_of)
        self.driver = self.moving.driver
        self.parts = [self.live, self.moving, self]

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
def view(rig, tmp_path, monkeypatch):
    for limit in ("SILENT_S", "OLD_S"):
        monkeypatch.setattr(heartbeat, limit, PATIENT_S)  # test_moving.py has the real limits
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


def take_control(view, tab):
    tab.get_by_role("button", name="connect …").click()
    tab.get_by_text("HAZARD").wait_for()
    tab.get_by_role("button", name="energise", exact=True).click()
    wait(tab, lambda: view.driver.desk.stage is Stage.ENABLED)
    tab.get_by_role("button", name="take control").click()
    wait(tab, lambda: view.driver.desk.stage is Stage.CONTROL)
    wait(tab, lambda: view.driver.heartbeat.given_s(view.driver.desk.holder) > 0.0)  # once it has answered it is obeyed


def raise_arm(view, tab):
    """Off the table, elbow and shoulder bent."""
    for joint, value in zip(range(1, 7), RAISED, strict=True):
        slide(tab, f"joint_{joint}, rad", value)
    wait(tab, lambda: np.abs(view.state.q - RAISED).max() < 0.05)


def test_an_arm_is_moved_by_slider(view, tmp_path):
    errors = []
    with browser_page(view.page.url, errors, *SIZE) as tab:
        tab.get_by_text("WATCHING").wait_for()
        slide(tab, JOINT, 0.3)
        tab.get_by_text("the arms are not connected").first.wait_for()
        take_control(view, tab)
        raise_arm(view, tab)
        slide(tab, JOINT, 0.4)
        wait(tab, lambda: abs(view.state.q[0] - 0.4) < 0.02)
        take_picture(tab, tmp_path)
    assert not errors


def on_canvas(view, point_m):
    """Where the page draws a point of the scene: x, y in pixels."""
    (client,) = view.page.server.get_clients().values()
    camera, turn = client.camera, np.empty(9)
    mujoco.mju_quat2Mat(turn, camera.wxyz)
    x, y, depth = turn.reshape(3, 3).T @ (point_m - camera.position)
    focal_px = SIZE[1] / 2 / np.tan(camera.fov / 2)
    return np.array(SIZE) / 2 + focal_px * np.array([x, y]) / depth


def tool_in_scene(view):
    """(4, 4) of the tool that the page draws."""
    base_m, _ = view.live.place_of(view.driver.session.key(ARM))
    pose = YamKinematics("yam", "linear_4310").fk(view.state.setpoint_q)
    pose[:3, 3] += base_m
    return pose


def test_the_tool_is_dragged_by_the_mouse(view):
    errors = []
    with browser_page(view.page.url, errors, *SIZE) as tab:
        take_control(view, tab)
        raise_arm(view, tab)
        before = tool_in_scene(view)
        start, down = before[:3, 3], before[:3, 0]  # x points down where a tool points forward
        grip_m = start + 0.18 * down  # about the middle of the arrow
        tab.mouse.move(*on_canvas(view, grip_m))
        tab.mouse.down()
        tab.mouse.move(*on_canvas(view, grip_m - 0.1 * down), steps=10)
        tab.mouse.up()
        wait(tab, lambda: (start - tool_in_scene(view)[:3, 3]) @ down > 0.07)
        wait(tab, lambda: view.state.mode is Mode.HOLD)
        after = tool_in_scene(view)
        position_m, angle_rad = pose_errors(before, after)
        assert position_m < 0.13 and angle_rad < 0.05
        assert np.linalg.norm(np.cross(after[:3, 3] - start, down)) < 0.01
    assert not errors
