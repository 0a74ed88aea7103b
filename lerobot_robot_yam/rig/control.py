"""The control client of a virtual rig, under the name that programs outside this repository use."""

from lerobot_robot_yam.rig.client.rig_control import RigControl

__all__ = ["RigControl"]
