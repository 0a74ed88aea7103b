"""A made-up arm of seven joints (`profiles/arm7.yaml`), and a scene in which one leads another."""

from pathlib import Path

ARM = str(Path(__file__).parent / "profiles" / "arm7.yaml")
STOPS = [3.25, -3.3]  # of the gripper
KEYS = [*(f"joint_{n}.pos" for n in range(1, 8)), "gripper.pos"]
REACH = [0.3, 1.2, 1.3, 0.5, 0.3, -0.4, 0.6]

_SCENE = f"""
name: seven_joints
arms:
  - {{channel: follower_left, role: follower, arm: "{ARM}", gripper: linear_4310, position_m: [0, 0.3, 0],
     stops_rad: {STOPS}}}
  - {{channel: leader_left, role: leader, arm: "{ARM}", gripper: yam_teaching_handle, position_m: [0, -0.3, 0]}}
cameras:
  - {{name: wrist, body: follower_left/link7, position_m: [0.1, 0, 0], target_m: [0, 0, -0.2]}}
"""


def write_scene(folder):
    """Path of the scene's file."""
    path = folder / "seven_joints.yaml"
    path.write_text(_SCENE)
    return str(path)
