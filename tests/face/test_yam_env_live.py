"""A robot as an environment in real time: who lays out the scene, who judges, and how many rigs there are."""

import os
import pty
import sys
import threading
import time

import gymnasium as gym
import pytest

from lerobot_robot_yam.config_yam_env import YamEnvConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.referee import find_judge
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.yam_env import YamEnv
from tests.face.test_yam_env import robot


@pytest.mark.long
def test_an_operator_lays_out_and_judges(tmp_path, monkeypatch):
    terminal, stdin = pty.openpty()
    with running_rig(arms=["follower_left"]) as rig, os.fdopen(stdin) as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        live = robot(tmp_path, can_options={"rig": rig.name}, cameras={}, gripper_stops_rad=[3.25, -3.3])
        env = YamEnv(YamEnvConfig(robot=live, success="operator", task="Stack the cups", fps=10))
        try:
            laid_out = threading.Event()

            def lay_out():
                time.sleep(3.0)
                while not laid_out.wait(0.5):  # what comes before it asks does not count
                    os.write(terminal, b" ")

            operator = threading.Thread(target=lay_out)
            operator.start()
            begin = time.monotonic()
            observation, _ = env.reset(seed=0)
            assert time.monotonic() - begin > 2.5  # it has waited
            laid_out.set()
            operator.join()
            assert env.task_description == "Stack the cups"
            assert not env.step(observation["agent_pos"])[2]
            os.write(terminal, b"s")
            time.sleep(0.3)
            _, reward, terminated, _, info = env.step(observation["agent_pos"])
            assert terminated and reward == 1.0 and info["is_success"]
        finally:
            env.close()
            os.close(terminal)


def test_a_judge_may_lie_in_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [path for path in sys.path if path])
    (tmp_path / "judge_of_this_test.py").write_text("def judge(seen):\n    return True\n\nnothing = 3\n")
    assert find_judge("judge_of_this_test:judge")({}) is True
    with pytest.raises(ConfigError, match="3 and cannot judge"):
        find_judge("judge_of_this_test:nothing")


@pytest.mark.long
def test_several_on_live_rigs_have_one_each(tmp_path):
    envs = YamEnvConfig(robot=robot(tmp_path, cameras={}, gripper_stops_rad=[3.25, -3.3])).create_envs(2)["yam"][0]
    try:
        assert isinstance(envs, gym.vector.SyncVectorEnv) and envs.num_envs == 2
        envs.reset(seed=[11, 12])
        rigs = [env.unwrapped._rig for env in envs.envs]
        assert rigs[0].name != rigs[1].name and [rig.task_state()["seed"] for rig in rigs] == [11, 12]
    finally:
        envs.close()
