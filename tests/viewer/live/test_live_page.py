"""yam-view in a real browser: it shows an arm, stops it, and lives through the end and the return of its session."""

import contextlib

import pytest

from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.live.rig_world import RigWorld
from tests.support.browser import browser_page, yam_view
from tests.support.rigged import arm_on

pytestmark = pytest.mark.long

ARM = "follower_left"


def shows(page, text):
    """Wait until a text is to be seen on the page."""
    page.get_by_text(text).first.wait_for()


def test_an_arm_is_shown_and_stopped_and_comes_back():
    errors = []
    with running_rig(arms=[ARM]) as rig, yam_view() as url, contextlib.closing(arm_on(rig, ARM).connect()) as arm:
        with browser_page(url, errors) as page:
            shows(page, ARM)
            shows(page, "HOLD")
            assert rig.stats()["clients"] == 2  # this test and the arm's loop: the page has asked the rig nothing
            with contextlib.closing(RigWorld(rig.name)) as world:
                assert world.read() and world.base(ARM) is not None
            banner = page.locator("#yam-banner")
            assert banner.is_hidden()

            page.get_by_role("button", name="EMERGENCY STOP").click()
            banner.get_by_text("EMERGENCY STOP: yam-view").wait_for()
            shows(page, "STOPPED")
            assert arm.observe().mode is Mode.STOPPED
            page.get_by_role("button", name="release the emergency stop").click()
            page.get_by_role("button", name="release", exact=True).click()
            banner.wait_for(state="hidden")

            arm.close()
            shows(page, "no arm runs on this computer")
            with contextlib.closing(arm_on(rig, ARM).connect()):
                shows(page, ARM)
                shows(page, "HOLD")
    assert not errors
