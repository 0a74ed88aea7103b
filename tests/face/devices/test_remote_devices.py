"""Robot and teleoperator whose arms another computer has: what LeRobot sees of them is what it sees of local ones."""

import os
import signal
import time

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_follower import BiYamRemoteConfig, YamRemoteConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.records import coupling_number
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.runtime_dirs import sessions
from lerobot_robot_yam.system.runtime_files import runtime_dir
from lerobot_robot_yam.yam_follower import BiYamRemote
from lerobot_teleoperator_yam.config_yam_leader import BiYamRemoteLeaderConfig
from lerobot_teleoperator_yam.yam_leader import BiYamRemoteLeader
from tests.support.hosted import free_port, rig_file, running_host
from tests.support.rigged import carry

pytestmark = [pytest.mark.long, pytest.mark.alone]


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    directory = tmp_path_factory.mktemp("host")
    with running_rig() as rig, running_host(rig_file(directory, rig, gate="always", mirror=False), directory) as host:
        yield host


def test_followers_follow_leaders_at_loop_rate_and_their_keys_are_those_of_local_ones(host):
    robot = BiYamRemote(BiYamRemoteConfig(host=str(host.address), observe_velocity=True))
    leader = BiYamRemoteLeader(BiYamRemoteLeaderConfig(host=str(host.address)))
    assert list(robot.action_features) == list(leader.action_features)
    assert robot.name == "bi_yam_follower" and "left_joint_1.vel" in robot.observation_features
    assert robot.is_calibrated and leader.is_calibrated and not robot.is_connected
    robot.connect()
    try:
        leader.connect()
        with pytest.raises(ConfigError, match="on its own computer"):
            robot.calibrate()
        begin = time.monotonic()
        while time.monotonic() - begin < 2.0:
            action = leader.get_action()
            sent = robot.send_action(action)
            assert sent.keys() == action.keys() and np.isfinite(list(sent.values())).all()
            time.sleep(0.03)
        followed = [state.coupled_to for state in robot._arms.newest()]
        assert followed == [coupling_number(side.key) for side in leader._arms.sides]
        observation = robot.get_observation()
        assert max(abs(observation[key] - action[key]) for key in action) < 0.1
    finally:
        robot.disconnect()
        leader.disconnect()


def test_what_cannot_be_is_refused_in_one_line(host):
    with pytest.raises(RefusedConfigError, match="its type here is bi_yam_remote"):
        YamRemoteConfig(host=str(host.address))
    with pytest.raises(RefusedConfigError, match="runs on the host"):
        BiYamRemoteConfig(host=str(host.address), isolation="thread")
    with pytest.raises(RefusedConfigError, match="no yam-host answers at"):
        BiYamRemoteConfig(host=f"127.0.0.1:{free_port()}")
    with pytest.raises(RefusedConfigError, match="write NAME or ADDRESS"):
        BiYamRemoteConfig(host="")
    with pytest.raises(RefusedConfigError, match="No such file"):
        BiYamRemoteConfig(host=str(host.address), key="no.json")


def test_nobody_lands_a_leader_that_a_person_has_in_the_hand(tmp_path):
    """The workstation is gone; the host lands the arms once the leaders lie at their rest."""
    with running_rig() as rig:
        file = rig_file(tmp_path, rig, gate="always")
        with running_host(file, tmp_path, "--land_after_s=2") as host:
            robot = BiYamRemote(BiYamRemoteConfig(host=str(host.address)))
            leader = BiYamRemoteLeader(BiYamRemoteLeaderConfig(host=str(host.address)))
            rest = np.array(rig.state()["arms"]["leader_left"]["q"][:6])
            robot.connect()
            leader.connect()
            carry(rig, SYSTEM, "leader_left", rest + [0.0, 0.6, 0.6, 0.0, 0.0, 0.0])
            rig.hand("leader_left", [30.0], [(rest + [0.0, 0.6, 0.6, 0.0, 0.0, 0.0]).tolist()], 0.0)
            robot.send_action(leader.get_action())
            for key, pid in sessions(runtime_dir()).items():
                if key.startswith("remote.") and key.endswith("left"):
                    os.kill(int(pid), signal.SIGKILL)
            time.sleep(6.0)
            assert len(driven(rig)) == 4, host.said()
            rig.release("leader_left")
            carry(rig, SYSTEM, "leader_left", rest)
            deadline = time.monotonic() + 30.0
            while driven(rig):
                assert time.monotonic() < deadline, host.said()
                time.sleep(0.1)
            robot.disconnect()
            leader.disconnect()


def driven(rig):
    """Channels of arms that have torque."""
    arms = rig.state()["arms"]
    return [channel for channel, arm in arms.items() if any(motor["enabled"] for motor in arm["motors"].values())]
