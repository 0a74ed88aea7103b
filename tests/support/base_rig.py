"""A base on the virtual rig that differs from its profile, for the tests of tools."""

import yaml

from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.scene.scene import load_scene

STEER = ("rear_left_steer", "front_left_steer", "front_right_steer", "rear_right_steer")


def scene(tmp_path, **placement):
    """The file of a scene with one base, with these fields of `BasePlacement`."""
    path = tmp_path / "crooked_base.yaml"
    path.write_text(yaml.safe_dump({"name": "crooked", "base": {"channel": "base", **placement}}))
    load_scene(path)
    return str(path)


def arguments(rig, *more, arm=("--arm", "base")):
    interface = ["--interface", "yam_lockstep"] if isinstance(rig, LockstepRig) else []
    return ["--channel", "base", *arm, *interface, "--rig", rig.name, *more]


def motors(rig):
    return rig.state()["base"]["motors"]
