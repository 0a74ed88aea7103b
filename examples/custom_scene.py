"""python examples/custom_scene.py

Run a task of your own: start a virtual rig with the scene `push_the_block.yaml`, push the block with the closed
gripper, and ask the rig for its verdict. docs/scenes.md says how to write a scene.
"""

from pathlib import Path

import numpy as np

from lerobot_robot_yam import YamArm, YamKinematics
from lerobot_robot_yam.rig.control import RigControl

SCENE = Path(__file__).with_name("push_the_block.yaml")
DOWN = np.diag([-1.0, 1.0, -1.0])  # rotation of a tool that points down
WAY_M = [(0.24, 0.15), (0.24, 0.04), (0.28, 0.04), (0.32, 0.04), (0.36, 0.04), (0.40, 0.04)]  # x and z of the fingers


def main() -> None:
    kinematics = YamKinematics("yam", "linear_4310", site="grasp_site")
    with (
        RigControl.start(SCENE, arms=["follower_left"]) as rig,
        YamArm(interface="yam_sim", channel="follower_left", can_options={"rig": rig.name}) as arm,
    ):
        rig.task("push", seed=0)
        q = None
        for x, z in WAY_M:  # in the frame of the arm's base
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = DOWN, [x, 0.0, z]
            q = kinematics.ik(pose, near=q).q
            arm.move_to(q, gripper=0.0, speed_rad_s=0.5)
        arm.clock.sleep(0.5)
        verdict = rig.task_state()
        print("block at", np.round(rig.state()["props"]["block"]["pos"], 2))
        print("success" if verdict["success"] else "no success", f"after {verdict['since_s']:.0f} s")
    print("landed")


if __name__ == "__main__":
    main()
