"""A controller that Commander has started: it serves, energises nothing whatever is stored, and ends with its owner."""

import contextlib
import os
import time

import pytest

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.wire import ask_once
from tests.waldo.conformance import HOST, free_port

pytestmark = pytest.mark.usefixtures("waldoctl")


@contextlib.contextmanager
def started(port, channel="", host=HOST):
    """A `Robot` whose controller runs meanwhile."""
    from lerobot_robot_yam.waldo.robot import Robot

    robot = Robot()
    try:
        robot.start(host=host, port=port, com_port=channel)
        yield robot
    finally:
        robot.stop()


def test_a_stored_channel_arms_nothing():
    from lerobot_robot_yam import RobotClient

    port = free_port()
    with started(port, "can_nowhere"), RobotClient(HOST, port) as rbt:
        assert rbt.is_simulator() and not rbt.ping().hardware_connected and rbt.reset() == 1
        with pytest.raises(ControllerError, match="can_nowhere: it is not armed; at its computer: yam-waldo arm"):
            rbt.simulator(False)
        assert rbt.connect_hardware("can_nowhere") == 1
        with pytest.raises(ControllerError, match="this controller has can_nowhere, not 'can0'"):
            rbt.connect_hardware("can0")
    assert ask_once(HOST, port, "ping") is None


def test_a_port_that_is_served_is_left_alone():
    port = free_port()
    with started(port) as robot:
        pid = ask_once(HOST, port, "ping")["pid"]
        with pytest.raises(ControllerError, match=rf"somebody serves {HOST}:{port} already"), started(port):
            pass
        assert ask_once(HOST, port, "ping")["pid"] == pid
        robot.stop()


@pytest.mark.long
def test_a_forked_worker_of_the_host_ends_nothing():
    port = free_port()
    with started(port) as robot:
        worker = os.fork()
        if worker == 0:
            robot.stop()
            os._exit(0)
        os.waitpid(worker, 0)
        assert ask_once(HOST, port, "ping") is not None


def test_a_controller_that_cannot_start_is_told_at_once():
    begun = time.monotonic()
    with pytest.raises(ControllerError, match="ended at its start; see its message above"):
        with started(free_port(), host="192.0.2.1"):  # no address of this computer
            pass
    assert time.monotonic() - begun < 30.0  # it did not wait for the time-out
