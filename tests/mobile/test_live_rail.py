"""The rail in real time: killed in motion, its brake takes the carriage; the program on the page."""

import os
import signal
import time

import pytest

from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.modes import Mode
from tests.mobile.rails import MOST_FALL_M, SCENE, STROKE_M, calibrated, lift
from tests.support.pages import block
from tests.support.waiting import wait

pytestmark = pytest.mark.alone


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "rail.yaml").write_text(SCENE.format(0.4, STROKE_M))
    calibrated(tmp_path / "rail.json", 0.4, STROKE_M)
    with RigControl.start(str(tmp_path / "rail.yaml")) as rig:
        yield rig


@pytest.fixture
def base(rig, tmp_path):
    rail = {"io": "sim", "calibration_path": str(tmp_path / "rail.json")}
    base = YamBase(channel="base", interface="yam_sim", can_options={"rig": rig.name}, rail=rail)
    yield base.connect()
    base.close()


def rail_of(rig):
    base = rig.state()["base"]
    return base["rail"] | {"enabled": base["motors"]["rail"]["enabled"]}


def stand_by_of(control):
    """Return the pid of the stand-by: the one child of the control process."""
    (child,) = map(int, open(f"/proc/{control}/task/{control}/children").read().split())
    return child


def test_the_stand_by_brakes_it_when_its_loop_is_killed_in_motion(rig, base):
    lift(base, 0.3, 0.8)
    assert base.observe().mode is Mode.TRACK and base.rail_state().velocity_m_s == pytest.approx(0.3, abs=0.05)
    os.kill(int(base._client.published()._record["owner_pid"]), signal.SIGKILL)
    highest, falls = rail_of(rig)["height"], []
    until_s = time.monotonic() + 30.0
    while (now := rail_of(rig))["enabled"] and time.monotonic() < until_s:
        highest = max(highest, now["height"])
        falls.append(highest - now["height"])
    time.sleep(0.5)
    end = rail_of(rig)
    assert not end["enabled"] and end["brake_on"] and max(*falls, highest - end["height"]) < MOST_FALL_M


@pytest.mark.long
def test_it_goes_on_when_its_stand_by_is_killed(rig, base):
    control = int(base._client.published()._record["owner_pid"])
    os.kill(stand_by_of(control), signal.SIGKILL)
    lift(base, 0.2, 0.5)
    before = rail_of(rig)["height"]
    base.close()
    end = rail_of(rig)
    assert not end["enabled"] and end["brake_on"] and before - end["height"] < MOST_FALL_M


@pytest.mark.long
def test_its_caller_is_killed(rig, base):
    """The loop lands by itself: the brake takes the carriage before torque is cut."""
    lift(base, 0.2, 0.5)
    before = rail_of(rig)["height"]
    base._session._runner._lifeline.close()
    wait(lambda: not rail_of(rig)["enabled"])
    end = rail_of(rig)
    assert end["brake_on"] and before - end["height"] < MOST_FALL_M


@pytest.mark.long
def test_the_program_on_the_page(capfd):
    exec(block("docs/mobile-base.md", "python", "home_rail()"), {})
    assert "homed=True" in capfd.readouterr().out
