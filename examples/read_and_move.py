"""python examples/read_and_move.py

Read one arm, move it, read it again, and land it. The arm is one of the virtual rig. For a real arm replace the two
arguments of `YamArm` by `channel="can_follower_l"`.
"""

import numpy as np

from lerobot_robot_yam import YamArm

POSE = [0.0, 1.0, 1.0, 0.0, 0.0, 0.0]  # rad


def main() -> None:
    with YamArm(interface="yam_sim", channel="follower_left") as arm:  # on leaving, the arm lands
        print("at the start:", np.round(arm.observe().q, 2))
        arm.move_to(POSE, gripper=1.0)  # 0 closed … 1 open; waits until the arm is there
        state = arm.observe()
        print("moved to:", np.round(state.q, 2), f"gripper {state.gripper:.2f}")
        print("torques in Nm:", np.round(state.tau_nm, 1))
        arm.move_to(POSE, gripper=0.0)
        print(f"gripper {arm.observe().gripper:.2f}")
    print("landed")


if __name__ == "__main__":
    main()
