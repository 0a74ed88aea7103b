"""A page that drives an arm of a virtual rig, and browsers on it."""

import contextlib
import time

import pytest

from lerobot_robot_yam.viewer.moving.driving_plan import plan_of
from lerobot_robot_yam.viewer.moving.moving import Moving
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support.browser_socket import BrowserSocket
from tests.support.rigged import rig_of, sim_config

ARM = "follower_left"
RAISED = [0.0, 0.5, 0.5, 0.0, 0.0, 0.0]
_PORT = 18480
_PLACE = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
_PATIENCE_S = 60.0


class Station:
    """A page that drives an arm on a rig in lock-step, and browsers on it. The test makes its rounds.

    Attributes:
        pace_s: real time that a round takes at least. Browsers answer in real time.
        parts: of the page, that are updated in each round, too.
    """

    def __init__(self, rig, tmp_path, plan=None):
        self.rig, self._browsers, self.pace_s, self.parts = rig, [], 0.002, []
        self.page = Page(port=_PORT)
        plan = plan or plan_of([sim_config(rig, ARM)], tmp_path / "poses.json")
        self.moving = Moving(self.page.server, plan, lambda key: _PLACE, "lockstep")
        self.driver = self.moving.driver

    def browser(self):
        """A new tab."""
        self._browsers.append(BrowserSocket(self.page.server.get_port()))
        return self._browsers[-1]

    def round(self):
        """What the page does 50 times a second."""
        begin_s = time.monotonic()
        self.driver.round()
        self.moving.update(begin_s)
        for part in self.parts:
            part.update()
        (self.driver.session.clock if self.driver.session.running else self.rig).sleep(0.02)
        time.sleep(max(0.001, begin_s + self.pace_s - time.monotonic()))

    def run(self, until):
        """Rounds, until this is so."""
        deadline = time.monotonic() + _PATIENCE_S
        while not until():
            assert time.monotonic() < deadline, [browser.notices for browser in self._browsers]
            self.round()

    def take_control(self, browser):
        """Connect the arm, if nobody has, and give a browser control."""
        if not self.driver.session.running:
            browser.press("connect …")
            browser.press("energise")
            while not self.driver.session.running:
                if ARM in self.rig.state()["arms"]:
                    self.rig.set_pose(ARM, RAISED)  # in a hand, until it is energised
                self.round()
        told = len(browser.notices)
        browser.press("take control")
        self.run(lambda: any("controls the arms" in notice for notice in browser.notices[told:]))

    @property
    def state(self):
        """Of the arm."""
        return self.driver.arms[ARM].client.published()

    def close(self):
        """Close all tabs, throw the arm's world away, end the page."""
        with contextlib.ExitStack() as stack:
            stack.callback(self.page.close)
            stack.callback(self.moving.close)
            stack.callback(self.driver.session.discard)
            for browser in self._browsers:
                stack.callback(browser.close)


@pytest.fixture
def rig():
    with rig_of("lockstep", arms=[ARM]) as rig:
        yield rig


@pytest.fixture
def station(rig, tmp_path):
    station = Station(rig, tmp_path)
    yield station
    station.close()


@pytest.fixture
def controlling(station):
    """A browser that controls the arm."""
    browser = station.browser()
    station.take_control(browser)
    return browser
