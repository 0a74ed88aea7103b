"""Arms of a virtual rig, configured as what they are; in lock-step with a rig that is."""

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.session import ArmSession
from lerobot_robot_yam.arm.yam_arm import YamArm
from lerobot_robot_yam.clock import SYSTEM
from lerobot_robot_yam.rig.lockstep import LockstepRig

STOPS = [3.25, -3.3]  # of the gripper in the default scene: nothing has to be searched


def sim_config(rig, channel, **fields):
    """A follower that holds or a leader that floats, weighing what the model says."""
    interface = "yam_lockstep" if isinstance(rig, LockstepRig) else "yam_sim"
    fields = {"gravity_factor": [1.0] * 6, "interface": interface} | fields
    if channel.startswith("leader"):
        fields = {"gripper": "yam_teaching_handle", "start": "float"} | fields
    else:
        fields = {"gripper_stops_rad": STOPS} | fields
    return ArmConfig(name=channel, channel=channel, can_options={"rig": rig.name}, **fields)


def isolation_of(rig):
    """Where the control loop of arms on that rig runs."""
    return "lockstep" if isinstance(rig, LockstepRig) else "process"


def arm_on(rig, channel, **fields):
    """One arm, not yet connected."""
    return YamArm(sim_config(rig, channel, **fields), isolation=isolation_of(rig))


def session_on(rig, *configs):
    """A session, not yet started."""
    return ArmSession(configs, isolation_of(rig))


def pause(rig, seconds):
    """Let time pass on a rig while no session runs on it."""
    (rig if isinstance(rig, LockstepRig) else SYSTEM).sleep(seconds)


def track(session, poses, seconds, gripper=0.5):
    """Stream one pose (6,) per arm."""
    clock = session.clock
    deadline = clock.now() + seconds
    while clock.now() < deadline:
        for name, pose in poses.items():
            session[name].track(pose, gripper)
        clock.sleep(0.02)
