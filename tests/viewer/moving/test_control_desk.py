"""Who may drive the arms, and when."""

import pytest

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.viewer.moving.control_desk import ControlDesk, Stage

FIRST, SECOND, THIRD = 1, 2, 3


@pytest.fixture
def enabled():
    desk = ControlDesk()
    desk.begin()
    desk.enable()
    return desk


@pytest.fixture
def controlled(enabled):
    assert enabled.take(FIRST)
    return enabled


def test_a_command_is_refused_with_what_to_do_until_the_browser_has_control():
    desk = ControlDesk()
    with pytest.raises(LifeCycleError, match="press `connect …` and confirm it"):
        desk.check(FIRST)
    with pytest.raises(LifeCycleError, match="press `connect …` and confirm it"):
        desk.take(FIRST)
    desk.begin()
    with pytest.raises(LifeCycleError, match="are being connected: wait"):
        desk.check(FIRST)
    desk.enable()
    with pytest.raises(LifeCycleError, match="press `take control`"):
        desk.check(FIRST)
    assert desk.take(FIRST)
    desk.check(FIRST)
    assert desk.stage is Stage.CONTROL


def test_arms_are_connected_once(enabled):
    with pytest.raises(LifeCycleError, match="connected already"):
        enabled.begin()


def test_one_browser_controls_and_hands_over_to_the_one_that_asks(controlled):
    with pytest.raises(LifeCycleError, match="browser 1 controls the arms"):
        controlled.check(SECOND)
    assert not controlled.take(SECOND)
    assert (controlled.holder, controlled.asker) == (FIRST, SECOND)
    with pytest.raises(LifeCycleError):
        controlled.give(SECOND)
    assert controlled.give(FIRST) == SECOND
    assert (controlled.holder, controlled.asker) == (SECOND, None)
    with pytest.raises(LifeCycleError):
        controlled.check(FIRST)


def test_control_that_nobody_asks_for_is_given_to_nobody(controlled):
    assert controlled.give(FIRST) is None
    assert controlled.stage is Stage.ENABLED


def test_control_is_free_when_its_browser_is_lost_and_is_given_to_nobody_by_itself(controlled):
    controlled.take(SECOND)
    assert not controlled.lost(THIRD)
    assert controlled.lost(FIRST)
    assert (controlled.stage, controlled.holder, controlled.asker) == (Stage.ENABLED, None, None)
    assert controlled.take(THIRD)


def test_a_browser_that_has_asked_and_gone_gets_nothing(controlled):
    controlled.take(SECOND)
    controlled.lost(SECOND)
    assert controlled.give(FIRST) is None


def test_what_needs_no_control_is_refused_only_while_another_browser_has_it(controlled):
    controlled.check_unheld(FIRST)
    with pytest.raises(LifeCycleError, match="browser 1 controls"):
        controlled.check_unheld(SECOND)
    controlled.end()
    controlled.check_unheld(SECOND)
    assert controlled.stage is Stage.WATCHING
