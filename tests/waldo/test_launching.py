"""A controller that Commander has started: it serves, energises nothing whatever is stored, and ends with its owner."""

import os
import socket
import time

import pytest

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.arm_choice import ArmChoice
from lerobot_robot_yam.waldo.launching import LaunchedController
from lerobot_robot_yam.waldo.wire import ask_once

HOST = "127.0.0.1"


def free_port():
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        return taken.getsockname()[1]


def launched(port, channel=""):
    return LaunchedController(HOST, port, ArmChoice(), channel, timeout_s=30.0)


def test_a_stored_channel_arms_nothing(waldoctl):
    from lerobot_robot_yam import RobotClient

    port = free_port()
    controller = launched(port, "can_nowhere")
    try:
        with RobotClient(HOST, port) as rbt:
            assert rbt.is_simulator() and not rbt.ping().hardware_connected and rbt.reset() == 1
            with pytest.raises(ControllerError, match="can_nowhere: it is not armed; at its computer: yam-waldo arm"):
                rbt.simulator(False)
            assert rbt.connect_hardware("can_nowhere") == 1
            with pytest.raises(ControllerError, match="this controller has can_nowhere, not 'can0'"):
                rbt.connect_hardware("can0")
    finally:
        controller.stop()
    assert ask_once(HOST, port, "ping") is None


def test_a_port_that_is_served_is_left_alone():
    port = free_port()
    controller = launched(port)
    try:
        pid = ask_once(HOST, port, "ping")["pid"]
        with pytest.raises(ControllerError, match=rf"somebody serves {HOST}:{port} already"):
            launched(port)
        assert ask_once(HOST, port, "ping")["pid"] == pid
    finally:
        controller.stop()
        controller.stop()


@pytest.mark.long
def test_a_forked_worker_of_the_host_ends_nothing():
    port = free_port()
    controller = launched(port)
    try:
        worker = os.fork()
        if worker == 0:
            controller.stop()
            os._exit(0)
        os.waitpid(worker, 0)
        assert ask_once(HOST, port, "ping") is not None
    finally:
        controller.stop()


def test_a_controller_that_cannot_start_is_told_at_once(tmp_path):
    begun = time.monotonic()
    with pytest.raises(ControllerError, match="ended at its start; see its message above"):
        LaunchedController(HOST, free_port(), ArmChoice("yam_9"), "", timeout_s=60.0)
    assert time.monotonic() - begun < 30.0  # it did not wait for the time-out
