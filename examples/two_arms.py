"""python examples/two_arms.py

Move two arms of the virtual rig in step. One session drives both: its control loop sends to both arms in the same
tick. Targets are streamed at 50 Hz; the loop moves the arms to them under their speed limits.
"""

import math

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.session.arm_session import ArmSession

ARMS = {"left": "follower_left", "right": "follower_right"}
REACH = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # rad
PERIOD_S, SECONDS = 0.02, 6.0


def main() -> None:
    session = ArmSession([ArmConfig(name=name, channel=ch, interface="yam_sim") for name, ch in ARMS.items()])
    session.start()
    try:
        apart = 0.0
        for step in range(int(SECONDS / PERIOD_S)):
            share = 0.5 - 0.5 * math.cos(2.0 * math.pi * step * PERIOD_S / SECONDS)  # out and back
            for name in ARMS:
                session[name].write_target(share * REACH, 1.0 - share)
            session.clock.sleep(PERIOD_S)
            left, right = (session[name].observe() for name in ARMS)
            apart = max(apart, float(np.abs(left.q - right.q).max()))
        print(f"the arms were never more than {apart:.3f} rad apart")
    finally:
        session.stop()  # lands both arms
    print("landed")


if __name__ == "__main__":
    main()
