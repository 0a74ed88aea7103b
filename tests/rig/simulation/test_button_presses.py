"""Handle buttons that are pressed for a time, in the live rig and in lock-step."""

import time

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig

LEADER = "leader_left"
ARMS = [LEADER, "follower_left"]


@pytest.fixture(params=["live", "lockstep"])
def rig_and_sleep(request):
    if request.param == "live":
        with running_rig(arms=ARMS) as rig:
            yield rig, time.sleep
    else:
        rig = LockstepRig(arms=ARMS)
        yield rig, rig.sleep
        rig.close()


def edges(rig):
    return [(event["button"], event["down"]) for event in rig.events() if event["kind"] == "button"]


def test_a_press_ends_by_itself(rig_and_sleep):
    rig, sleep = rig_and_sleep
    rig.press(LEADER, "record", 0.1)
    assert rig.state()["arms"][LEADER]["buttons"] == [False, True]
    sleep(0.5)
    assert rig.state()["arms"][LEADER]["buttons"] == [False, False]
    assert edges(rig) == [("record", True), ("record", False)]


def test_a_button_that_is_held_stays_down_after_a_press_of_the_other(rig_and_sleep):
    rig, sleep = rig_and_sleep
    rig.buttons(LEADER, sync=True)
    rig.press(LEADER, "record", 0.02)
    sleep(0.4)
    assert rig.state()["arms"][LEADER]["buttons"] == [True, False]
    rig.buttons(LEADER)
    assert edges(rig) == [("sync", True), ("record", True), ("record", False), ("sync", False)]


def test_a_press_lasts_as_long_as_was_asked():
    rig = LockstepRig(arms=ARMS)
    rig.press(LEADER, "sync", 0.1)
    rig.sleep(0.05)
    rig.press(LEADER, "sync", 0.1)  # once more, before the first has ended: no second edge
    rig.sleep(0.5)
    down, up = (event["sim_s"] for event in rig.events() if event["kind"] == "button")
    rig.close()
    assert up - down == pytest.approx(0.15, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("leader_left", "top", 0.1), "sync, record"),
        (("leader_left", "sync", float("nan")), "finite"),
        (("leader_left", "sync", -1.0), "from 0.005"),
        (("leader_left", "sync", "long"), "finite number"),
        (("leader_middle", "sync", 0.1), "no channel 'leader_middle'"),
        (("follower_left", "sync", 0.1), "no teaching handle"),
    ],
)
def test_what_a_press_refuses(rig_and_sleep, arguments, message):
    rig, _ = rig_and_sleep
    with pytest.raises(ConfigError, match=message):
        rig.press(*arguments)
    assert edges(rig) == []
