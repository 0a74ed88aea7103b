"""A click on the emergency stop: how soon it stops an arm of the virtual rig, in a real browser; and one that fails.

`-s` shows the times; docs/measured.md has the figures. The file of the latch has the time of the kernel's last tick,
4 ms. The time of the stop is an upper bound: this test may see that state late.
"""

import contextlib
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.live.stop_button import StopButton
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support.browser import browser_page, yam_view
from tests.support.browser_socket import BrowserSocket
from tests.support.rigged import session_on, sim_config
from tests.support.waiting import wait

ARM = "follower_left"
CLICKS = 20
WAIT_S = 30.0
NOTE_CLICKS = """
addEventListener("click", event => { window.clickedMs = performance.timeOrigin + event.timeStamp }, true)
"""


def when(arm, mode):
    """Wait for a mode of an arm; the time (monotonic, s) of the first state that has it."""
    deadline_s = time.monotonic() + WAIT_S
    while (state := arm.published()).mode is not mode:
        assert time.monotonic() < deadline_s, state.mode
        time.sleep(0.001)
    return state.stamp_s


def click(page, arm):
    """Click the emergency stop; how long after that its file was there, and the loop had stopped the arm, s."""
    stop = EmergencyStop()
    with ThreadPoolExecutor() as beside:
        stopped = beside.submit(when, arm, Mode.STOPPED)
        page.get_by_role("button", name="EMERGENCY STOP", exact=True).click()
        stopped_s = stopped.result() + time.time() - time.monotonic()
    clicked_s = page.evaluate("window.clickedMs") / 1e3
    return Path(stop.directory, "emergency-stop").stat().st_mtime - clicked_s, stopped_s - clicked_s


@pytest.mark.long
@pytest.mark.alone
def test_every_click_stops_the_arm():
    errors, times_s = [], []
    with running_rig(arms=[ARM]) as rig, yam_view() as url, contextlib.ExitStack() as stack:
        session = session_on(rig, sim_config(rig, ARM))
        stack.callback(session.stop)
        session.start()
        page = stack.enter_context(browser_page(url, errors))
        page.get_by_text("HOLD").first.wait_for()
        page.evaluate(NOTE_CLICKS)
        stack.callback(EmergencyStop().release)  # else the arm would not land
        for _ in range(CLICKS):
            times_s.append(click(page, session[ARM]))
            EmergencyStop().release()
            when(session[ARM], Mode.HOLD)
            page.locator("#yam-banner").wait_for(state="hidden")
    latched_ms, stopped_ms = 1e3 * np.sort(times_s, axis=0).T
    sys.stdout.write(
        f"ms after the click: latched {latched_ms.round()}, median {np.median(latched_ms):.0f}; "
        f"arm stopped {stopped_ms.round()}, median {np.median(stopped_ms):.0f}"
    )
    assert not errors


def test_a_click_that_stops_nothing_says_so_and_the_next_one_stops():
    with contextlib.ExitStack() as stack:
        page = stack.enter_context(contextlib.closing(Page(port=0)))
        button = StopButton(page.server.gui)
        browser = stack.enter_context(contextlib.closing(BrowserSocket(page.server.get_port())))
        stack.callback(EmergencyStop().release)

        def said(words):
            wait(lambda: any(words in line for line in button.update()), WAIT_S, lambda: button.update())

        in_its_way = Path(EmergencyStop().directory, "emergency-stop")
        in_its_way.symlink_to("nowhere")  # no file can be made in its place
        browser.press("EMERGENCY STOP")
        said("THE EMERGENCY STOP FAILED: [Errno 20]")
        in_its_way.unlink()
        browser.press("EMERGENCY STOP")
        said("EMERGENCY STOP: yam-view (process")
        assert EmergencyStop().latched
