"""Arms are found by their locks and states, and none is forgotten that was left energised."""

import contextlib

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.state.about import forget_about, tell_about
from lerobot_robot_yam.state.faults import RESPONSES, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, lock_path, state_path
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock
from lerobot_robot_yam.viewer.live.arm_panel import describe, warnings
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArms

KEY = "desk.follower_left"
CONFIG = ArmConfig(channel="follower_left", name="left", interface="yam_sim", can_options={"rig": "desk"})


@contextlib.contextmanager
def session(config=CONFIG):
    """What there is of a session to be seen from outside; yields how it publishes."""
    block = SharedBlock(state_path(KEY), STATE_DTYPE, create=True)

    def publish(mode, at_s=0.0, **fields):
        record = np.zeros((), STATE_DTYPE)
        record["mode"], record["stamp_s"], record["joints"], record["motors"] = mode, at_s, 6, 7
        record["trigger"] = record["action"] = record["gripper_stops_rad"] = np.nan
        for name, value in fields.items():
            record[name] = value
        block.write(record)

    try:
        with FileLock(lock_path(KEY), KEY):
            if config is not None:
                tell_about(KEY, config)
            yield publish
    finally:
        forget_about(KEY)
        block.close()


def test_an_arm_comes_with_its_session_and_goes_with_it():
    with contextlib.closing(WatchedArms()) as watched:
        with session() as publish:
            publish(Mode.HOLD, at_s=1.0)
            watched.update(1.1)
            arm = watched.arms[KEY]
            assert (arm.name, arm.rig, arm.state.mode) == (f"left ({KEY})", "desk", Mode.HOLD) and not arm.stale
            assert arm.hardware.config.channel == "follower_left"
            publish(Mode.OFF, at_s=1.3)
        watched.update(2.0)
        assert not watched.arms and not watched.lost(2.0)


def test_an_arm_that_was_left_energised_is_named_until_a_session_has_it_again():
    with contextlib.closing(WatchedArms()) as watched:
        with session() as publish:
            publish(Mode.TRACK)
            watched.update(1.0)
        watched.update(2.0)
        (line,) = watched.lost(2.0)
        assert "left" in line and "TRACK" in line and not watched.lost(100.0)
        with session() as publish:
            publish(Mode.HOLD)
            watched.update(3.0)
            assert not watched.lost(3.0)
            publish(Mode.OFF)
        watched.update(4.0)


def test_silence_and_trouble_are_said_with_what_to_do():
    with contextlib.closing(WatchedArms()) as watched, session() as publish:
        publish(Mode.HOLD, at_s=1.0)
        watched.update(1.1)
        arm = watched.arms[KEY]
        assert not warnings(arm)
        watched.update(3.0)
        assert "NO STATE FOR 2.0 s" in warnings(arm)[0]
        publish(Mode.FAULT, at_s=3.0, trouble=Trouble.MOTOR_SILENT.value.encode(), message=b"joint3 <b>")
        watched.update(3.1)
        (line,) = warnings(arm)
        assert "joint3 <b>" in line and RESPONSES[Trouble.MOTOR_SILENT].rearm in line
        assert "joint3 &lt;b&gt;" in describe(arm)  # a name is text, not HTML
        publish(Mode.STOPPED, at_s=3.1)
        watched.update(3.2)
        assert "emergency stop" in warnings(arm)[0]


def test_an_arm_that_does_not_say_what_it_is_has_no_shape_and_is_shown_all_the_same():
    with contextlib.closing(WatchedArms()) as watched, session(config=None) as publish:
        publish(Mode.FLOAT, at_s=1.0)
        watched.update(1.0)
        arm = watched.arms[KEY]
        assert arm.hardware is None and arm.rig is None
        assert "FLOAT" in describe(arm) and "joint6" in describe(arm) and "gripper" in describe(arm)
        publish(Mode.OFF, at_s=1.0)
