"""The base in real time: its loop in a process of its own, killed and stopped in motion."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.modes import Mode
from tests.support.pages import block
from tests.support.waiting import wait

pytestmark = pytest.mark.alone


@pytest.fixture
def rig():
    with RigControl.start("mobile") as rig:
        yield rig


def driving(base, seconds=2.5):
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        base.set_target_velocity([0.4, 0.0, 0.0])
        time.sleep(0.03)


def enabled(rig):
    return [motor["enabled"] for motor in rig.state()["base"]["motors"].values()]


def test_it_is_braked_and_off_when_its_loop_is_killed_in_motion(rig):
    base = YamBase(channel="base", interface="yam_sim", can_options={"rig": rig.name})
    try:
        base.connect()
        driving(base)
        state = base.observe()
        assert state.mode is Mode.TRACK and state.body_twist[0] == pytest.approx(0.4, abs=0.1)
        pid = int(base._client.published()._record["owner_pid"])
        assert "mujoco" not in Path(f"/proc/{pid}/maps").read_text()  # a base needs no model of an arm
        os.kill(pid, signal.SIGKILL)
        at = np.array(rig.state()["base"]["pose"])
        wait(lambda: not any(enabled(rig)))
        away = np.array(rig.state()["base"]["pose"]) - at
        assert 0.1 < away[0] < 0.6 and abs(away[1]) < 0.1  # braked by 0.25 m/s² from 0.4 m/s: 0.32 m
    finally:
        base.close()


def test_the_program_on_the_page(capfd):
    exec(block("docs/mobile-base.md", "python", "YamBase(channel="), {})
    x, _, theta = map(float, capfd.readouterr().out.strip("[]\n ").split())
    assert 0.1 < x < 0.6 and 0.2 < theta < 1.0
