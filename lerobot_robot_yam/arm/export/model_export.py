"""Export of an arm with its end effector for other software: MJCF for MuJoCo, URDF for other programs.

Both formats have the links, inertias, joints, limits and sites of `model.build_spec`. Joints in the URDF are called
`joint_1`, `joint_2` … as in LeRobot's features.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping

import mujoco
import numpy as np

from lerobot_robot_yam.arm.export.body_meshes import Colour
from lerobot_robot_yam.arm.model import Physics, build_spec
from lerobot_robot_yam.arm.profile import EE_BODY, ArmProfile, GripperProfile

_ROOT = "world"
_NOWHERE = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))  # position and quaternion of a frame that equals its parent


def mjcf(arm: ArmProfile, gripper: GripperProfile) -> str:
    """Write MJCF text: the arm as in the virtual rig, with shapes, friction, stops and contacts, without actuators.

    MuJoCo writes six digits, so tool poses agree to 1e-6 m.

    Args:
        arm, gripper: resolved profiles, see `mounting.resolve_profiles`.
    """
    spec = build_spec(arm, gripper, physics=Physics())
    spec.compile()  # MuJoCo can write only compiled models
    return spec.to_xml()


def urdf(arm: ArmProfile, gripper: GripperProfile) -> str:
    """Write URDF text without shapes. Lengths in m, angles in rad; the root link is the frame of the arm's base.

    An additional joint `gripper` moves nothing: LeRobot requires a joint with the name of each feature.

    Args:
        arm, gripper: resolved profiles, see `mounting.resolve_profiles`.
    """
    model = build_spec(arm, gripper, visuals=False).compile()
    robot = _links(ET.Element("robot", name=f"{arm.name}_{gripper.name}"), model, arm, range(1, model.nbody))
    for site in map(model.site, range(model.nsite)):
        ET.SubElement(robot, "link", name=site.name)
        owner = model.body(model.site_bodyid[site.id]).name
        _add_joint(robot, f"{site.name}_mount", "fixed", (owner, site.name), (site.pos, site.quat))
    if gripper.motor is not None:
        ET.SubElement(robot, "link", name="gripper_opening")
        element = _add_joint(robot, "gripper", "revolute", (EE_BODY, "gripper_opening"), _NOWHERE)
        _add_way(element, np.array([0.0, 0.0, 1.0]), lower=0.0, upper=1.0, effort=1.0, velocity=1.0)
    return _text_of(robot)


def drawn_urdf(arm: ArmProfile, model: mujoco.MjModel, files: Mapping[str, Mapping[Colour, str]]) -> str:
    """Write URDF text for the arm alone, from its base to its last link, with meshes.

    Args:
        arm: resolved profile of the arm.
        model: model of the arm with any end effector.
        files: link -> colour -> URL of the mesh.
    """
    links = [model.body(body.name).id for body in arm.bodies]
    robot = _links(ET.Element("robot", name=arm.name), model, arm, links)
    for link in robot.iter("link"):
        for colour, url in files.get(link.get("name", ""), {}).items():
            visual = ET.SubElement(link, "visual")
            ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=url)
            material = ET.SubElement(visual, "material", name="colour_{:02x}{:02x}{:02x}".format(*colour))
            ET.SubElement(material, "color", rgba=_numbers(np.array([*colour, 255]) / 255.0))
    return _text_of(robot)


def frame(pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Compute a pose (4, 4) from a position (3,) and a quaternion w x y z (4,) of any length."""
    pose, turn, unit = np.eye(4), np.empty(9), np.array(quat, dtype=float)
    mujoco.mju_normalize4(unit)
    mujoco.mju_quat2Mat(turn, unit)
    pose[:3, :3], pose[:3, 3] = turn.reshape(3, 3), pos
    return pose


def rpy(turn: np.ndarray) -> np.ndarray:
    """Compute roll, pitch, yaw (3,) rad from a rotation (3, 3), R = Rz(yaw) Ry(pitch) Rx(roll)."""
    level = np.hypot(turn[0, 0], turn[1, 0])
    pitch = np.arctan2(-turn[2, 0], level)
    if level > 1e-9:
        roll, yaw = np.arctan2(turn[2, 1], turn[2, 2]), np.arctan2(turn[1, 0], turn[0, 0])
    else:  # roll and yaw have the same axis: assign the whole rotation to roll
        roll, yaw = np.arctan2(-turn[1, 2], turn[1, 1]), 0.0
    return np.array([roll, pitch, yaw])


def _links(robot: ET.Element, model: mujoco.MjModel, arm: ArmProfile, bodies: Iterable[int]) -> ET.Element:
    """Add a link for each of these bodies, and the joint to its parent."""
    ET.SubElement(robot, "link", name=_ROOT)
    for body in bodies:
        name, parent = model.body(body).name, model.body(model.body_parentid[body]).name
        _add_link(robot, model, body)
        place, joint = (model.body_pos[body], model.body_quat[body]), int(model.body_jntadr[body])
        if 0 <= joint < len(arm.motors):
            element = _add_joint(robot, arm.motors[joint].name, "revolute", (parent, name), place)
            lower, upper = model.jnt_range[joint]
            torque, speed = arm.torque_limit_nm[joint], arm.speed_limit_rad_s[joint]
            _add_way(element, model.jnt_axis[joint], lower=lower, upper=upper, effort=torque, velocity=speed)
        else:  # fingers are fixed at 0
            _add_joint(robot, f"{name}_mount", "fixed", (parent, name), place)
    return robot


def _add_link(robot: ET.Element, model: mujoco.MjModel, body: int) -> None:
    link = ET.SubElement(robot, "link", name=model.body(body).name)
    inertial = ET.SubElement(link, "inertial")
    inertial.append(_origin(model.body_ipos[body], model.body_iquat[body]))
    ET.SubElement(inertial, "mass", value=f"{model.body_mass[body]:.9g}")
    moments = {f"i{a}{a}": f"{m:.9g}" for a, m in zip("xyz", model.body_inertia[body], strict=True)}
    ET.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})


def _add_joint(
    robot: ET.Element, name: str, kind: str, links: tuple[str, str], place: tuple[np.ndarray, np.ndarray]
) -> ET.Element:
    """Add a joint. links: parent and child; place: position and quaternion of the child in the parent's frame."""
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    joint.append(_origin(*place))
    for tag, link in zip(("parent", "child"), links, strict=True):
        ET.SubElement(joint, tag, link=link)
    return joint


def _add_way(joint: ET.Element, axis: np.ndarray, **limits: float) -> None:
    ET.SubElement(joint, "axis", xyz=_numbers(axis))
    ET.SubElement(joint, "limit", {name: f"{value:.9g}" for name, value in limits.items()})


def _origin(pos: np.ndarray, quat: np.ndarray) -> ET.Element:
    return ET.Element("origin", xyz=_numbers(pos), rpy=_numbers(rpy(frame(pos, quat)[:3, :3])))


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _text_of(robot: ET.Element) -> str:
    ET.indent(robot)
    return f'<?xml version="1.0"?>\n{ET.tostring(robot, encoding="unicode")}\n'
