"""A stand-by takes a base over that has driven far: it knows its motors' turns, brakes the wheels and holds the load.

The controller of a stand-by is ticked here in the process of the test, on the bus of a rig in lock-step.
"""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.control.process.robot_loop import introduce, make_controller
from lerobot_robot_yam.mobile.robot_parts import resolve
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from tests.mobile.rails import MOST_FALL_M, Rail, lift


def taken_over(base, cut=lambda down: None):
    """The loop of the base dies; a new controller adopts its last state. cut: takes the link down, and up again."""
    record, part = base._client._block.read(), resolve(base._session._parts["base"].config)
    base._session.discard()
    bus = open_bus(part.config)
    controller = make_controller(part, bus)
    cut(True)
    controller.adopt(record, controller.clock.now())
    cut(False)
    introduce([controller])
    return controller, bus


def tick(controller, seconds):
    """Tick until it is off, at most for a time."""
    now = controller.clock.now
    last, until_s = now(), now() + seconds
    while not controller.status.ended and now() < until_s:
        controller.send()
        controller.clock.sleep(0.003)
        controller.collect(now() + 0.001)
        controller.measure(now())
        controller.decide(now())
        controller.end(now())
        controller.advance(now(), now() - last)
        last = now()


def test_wheels_beyond_the_range_of_their_frames_are_braked():
    with contextlib.closing(LockstepRig("mobile")) as rig:
        place = {"channel": "base", "interface": "yam_lockstep", "can_options": {"rig": rig.name}}
        base = YamBase(**place, isolation="lockstep").connect()
        for _ in range(80):
            base.set_target_velocity([0.5, 0.0, 0.0])
            base.clock.sleep(0.05)
        assert np.abs(base.wheel_states().drive_rad).max() > 20.0  # frames wrap at 12.5
        controller, bus = taken_over(base)
        assert controller.mode is Mode.LAND
        assert controller.motors.q[1:8:2] == pytest.approx(base_turns(controller), abs=2.0)
        begin = np.array(rig.state()["base"]["pose"])
        tick(controller, 8.0)
        gone = np.hypot(*(np.array(rig.state()["base"]["pose"]) - begin)[:2])
        assert controller.mode is Mode.OFF and 0.3 < gone < 0.7  # planned braking by 0.25 m/s²: 0.5 m
        assert not any(motor["enabled"] for motor in rig.state()["base"]["motors"].values())
        bus.shutdown()


def base_turns(controller):
    """Where the wheels are after 1.5 m: 30 rad each, by odometry."""
    return np.full(4, controller.motion.odometry.pose[0] / 0.05)


def test_a_load_that_has_risen_by_turns_is_held_though_its_brake_slips(tmp_path):
    rail = Rail(tmp_path, height_m=0.2)
    with contextlib.closing(rail.rig):
        base = rail.base().connect()
        lift(base, 0.4, 1.5)
        base.clock.sleep(1.2)
        controller, bus = taken_over(base)
        assert controller.motors.q[8] == pytest.approx(base_height_rad(rail), abs=0.2)
        rail.rig.fault("base_io", None, "brake_slips", True)
        rail.watch_fall()
        tick(controller, 3.0)
        assert controller.status.trouble is Trouble.RAIL_BRAKE and rail.enabled and rail.fallen_m < MOST_FALL_M
        controller.close()
        bus.shutdown()


def test_a_rail_taken_over_on_a_channel_that_is_down_for_a_moment_stays(tmp_path):
    rail = Rail(tmp_path, height_m=0.2)
    with contextlib.closing(rail.rig):
        base = rail.base().connect()
        base.clock.sleep(0.5)
        rail.watch_fall()
        controller, bus = taken_over(base, lambda down: rail.rig.fault("base", None, "link_down", down))
        tick(controller, 0.1)
        assert controller.mode is Mode.LAND and np.abs(controller.motors.asked[8]) < 1.0
        tick(controller, 3.0)
        assert controller.mode is Mode.OFF and rail.fallen_m < 1e-3
        controller.close()
        bus.shutdown()


def base_height_rad(rail):
    return 2.0 + rail.height_m / 0.03


def test_a_defect_on_the_way_to_off_leaves_no_motor_uncommanded(tmp_path, monkeypatch):
    rail = Rail(tmp_path, height_m=0.5)
    with contextlib.closing(rail.rig):
        base = rail.base().connect()
        controller, bus = taken_over(base)
        monkeypatch.setattr(controller.rail, "let_go", raises)
        tick(controller, 2.0)
        assert controller.status.trouble is Trouble.INTERNAL_ERROR and controller.mode is not Mode.OFF
        assert rail.enabled
        controller.close()
        bus.shutdown()


def raises():
    raise RuntimeError("a test")
