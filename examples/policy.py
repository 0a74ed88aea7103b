"""python examples/policy.py

Drive LeRobot's robot with a policy in ten lines. `YamFollower` is what `lerobot-record` and `lerobot-rollout` use:
observations and actions are dictionaries with the same keys, and a policy turns one into the other.
"""

import time

import numpy as np

from lerobot_robot_yam import YamFollower, YamFollowerConfig

RATE_HZ, SECONDS = 30.0, 6.0
GOAL = {"joint_2.pos": 1.0, "joint_3.pos": 1.0, "gripper.pos": 0.5}  # rad; gripper 0 closed … 1 open


class Reach:
    """From where the arm is, at most one stride per step towards the goal."""

    def __init__(self, goal: dict[str, float], stride: float = 0.1):
        self.goal, self.stride = goal, stride

    def select_action(self, observation: dict[str, float]) -> dict[str, float]:
        action = {}
        for key, value in observation.items():
            action[key] = value + float(np.clip(self.goal.get(key, 0.0) - value, -self.stride, self.stride))
        return action


def main() -> None:
    policy = Reach(GOAL)
    robot = YamFollower(YamFollowerConfig(id="example", interface="yam_sim", channel="follower_left"))
    robot.connect()
    try:
        for _ in range(int(RATE_HZ * SECONDS)):
            observation = robot.get_observation()  # no cameras here: numbers only
            robot.send_action(policy.select_action(observation))
            time.sleep(1.0 / RATE_HZ)
        print({key: round(float(value), 2) for key, value in robot.get_observation().items()})
    finally:
        robot.disconnect()  # lands the arm
    print("landed")


if __name__ == "__main__":
    main()
