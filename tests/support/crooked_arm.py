"""An arm of the rig whose motors' zeros are off, for the tests of zeroing."""

import yaml

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig

STOPS = [3.25, -3.3]
OFFSETS = [0.3, -0.2, 0.1, 0.25, -0.3, 0.2]  # zeros as they are when a motor was exchanged


def scene(tmp_path, zero_offset, arm="yam", gripper="linear_4310"):
    path = tmp_path / "scene.yaml"
    placement = {"channel": "only", "role": "follower", "arm": arm, "gripper": gripper, "position_m": [0, 0, 0]}
    path.write_text(yaml.safe_dump({"name": "one", "arms": [placement | {"zero_offset_rad": zero_offset}]}))
    return str(path)


def motor_rad(rig, channel="only"):
    return {name: motor["motor_rad"] for name, motor in rig.state()["arms"][channel]["motors"].items()}


def events(rig, kind):
    return [event for event in rig.events() if event["kind"] == kind]


def sent(rig, channel="only"):
    """Identifiers other than those of questions, in order."""
    return [ident for _, _, ident, _ in rig.trace(channel) if ident not in (0x7FF, 0x50E)]


def arguments(rig, *more, channel="only"):
    interface = ["--interface", "yam_lockstep"] if isinstance(rig, LockstepRig) else []
    return ["--channel", channel, *interface, "--rig", rig.name, *more]


def config(rig, **fields):
    return ArmConfig(
        **{
            "name": "left",
            "channel": "only",
            "interface": "yam_lockstep" if isinstance(rig, LockstepRig) else "yam_sim",
            "can_options": {"rig": rig.name},
            "gripper_stops_rad": STOPS,
        }
        | fields
    )
