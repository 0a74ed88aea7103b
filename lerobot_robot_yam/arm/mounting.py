"""What of an end effector depends on the arm that carries it."""

from dataclasses import replace

from lerobot_robot_yam.arm.profile import ArmProfile, Body, GripperProfile

_GRASP_SITE = "grasp_site"


def mounted(gripper: GripperProfile, arm: ArmProfile) -> GripperProfile:
    """The end effector as it is on this arm: its grasp point where the arm's own reference model has it."""
    return replace(gripper, bodies=tuple(_with_grasp_site(body, gripper.name, arm) for body in gripper.bodies))


def _with_grasp_site(body: Body, gripper: str, arm: ArmProfile) -> Body:
    point = (arm.grasp_site_m or {}).get(gripper)
    if point is None:
        return body
    sites = tuple(replace(site, pos_m=point) if site.name == _GRASP_SITE else site for site in body.sites)
    return replace(body, sites=sites)
