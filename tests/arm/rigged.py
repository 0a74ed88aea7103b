"""Arms of a virtual rig, configured as what they are."""

import time

from lerobot_robot_yam.arm.config import ArmConfig

STOPS = [3.25, -3.3]  # of the gripper in the default scene: nothing has to be searched


def sim_config(rig, channel, **fields):
    """A follower that holds or a leader that floats, weighing what the model says."""
    fields = {"gravity_factor": [1.0] * 6, "interface": "yam_sim"} | fields
    if channel.startswith("leader"):
        fields = {"gripper": "yam_teaching_handle", "start": "float"} | fields
    else:
        fields = {"gripper_stops_rad": STOPS} | fields
    return ArmConfig(name=channel, channel=channel, can_options={"rig": rig.name}, **fields)


def track(session, poses, seconds, gripper=0.5):
    """Stream one pose (6,) per arm."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for name, pose in poses.items():
            session[name].track(pose, gripper)
        time.sleep(0.02)
