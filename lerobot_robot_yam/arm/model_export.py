"""An arm with its end effector as a file for other software: MJCF for MuJoCo, URDF for everything else.

Both have the links, inertias, joints, limits and sites of `model.build_spec`.

The URDF has no shapes. Its joints are called `joint_1`, `joint_2` … as in LeRobot's features. A further joint
`gripper` moves nothing: LeRobot looks for one of each name.
"""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from lerobot_robot_yam.arm.model import EE_BODY, Physics, build_spec
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile

_ROOT = "world"


def mjcf(arm: ArmProfile, gripper: GripperProfile) -> str:
    """The text of a file for MuJoCo: the arm of the virtual rig, with its shapes, friction, stops and contacts.

    Nothing drives its joints: it has no actuators. MuJoCo writes six digits, so poses of the tool agree to 1e-6 m.

    Args:
        arm, gripper: resolved profiles, see `mounting.resolve_profiles`.
    """
    spec = build_spec(arm, gripper, physics=Physics())
    spec.compile()  # MuJoCo writes only what it has compiled
    return spec.to_xml()


def urdf(arm: ArmProfile, gripper: GripperProfile) -> str:
    """The text of the file. Lengths in m, angles in rad; the root link is the frame of the arm's base.

    Args:
        arm, gripper: resolved profiles, see `mounting.resolve_profiles`.
    """
    model = build_spec(arm, gripper, visuals=False).compile()
    robot = ET.Element("robot", name=f"{arm.name}_{gripper.name}")
    ET.SubElement(robot, "link", name=_ROOT)
    for body in range(1, model.nbody):
        name, parent = model.body(body).name, model.body(model.body_parentid[body]).name
        _add_link(robot, model, body)
        place = _origin(model.body_pos[body], model.body_quat[body])
        joint = int(model.body_jntadr[body])
        if 0 <= joint < len(arm.motors):
            element = _add_joint(robot, arm.motors[joint].name, "revolute", parent, name, place)
            ET.SubElement(element, "axis", xyz=_text(model.jnt_axis[joint]))
            lower, upper = model.jnt_range[joint]
            _add_limit(element, lower, upper, arm.torque_limit_nm[joint], arm.speed_limit_rad_s[joint])
        else:  # fingers stay where they are at 0
            _add_joint(robot, f"{name}_mount", "fixed", parent, name, place)
    for site in map(model.site, range(model.nsite)):
        ET.SubElement(robot, "link", name=site.name)
        owner = model.body(model.site_bodyid[site.id]).name
        _add_joint(robot, f"{site.name}_mount", "fixed", owner, site.name, _origin(site.pos, site.quat))
    if gripper.motor is not None:
        ET.SubElement(robot, "link", name="gripper_opening")
        element = _add_joint(robot, "gripper", "revolute", EE_BODY, "gripper_opening", _origin(np.zeros(3), _UNIT))
        ET.SubElement(element, "axis", xyz=_text(np.array([0.0, 0.0, 1.0])))
        _add_limit(element, 0.0, 1.0, 1.0, 1.0)
    ET.indent(robot)
    return f'<?xml version="1.0"?>\n{ET.tostring(robot, encoding="unicode")}\n'


_UNIT = np.array([1.0, 0.0, 0.0, 0.0])


def _add_link(robot: ET.Element, model: mujoco.MjModel, body: int) -> None:
    link = ET.SubElement(robot, "link", name=model.body(body).name)
    inertial = ET.SubElement(link, "inertial")
    inertial.append(_origin(model.body_ipos[body], model.body_iquat[body]))
    ET.SubElement(inertial, "mass", value=f"{model.body_mass[body]:.9g}")
    moments = {f"i{a}{a}": f"{m:.9g}" for a, m in zip("xyz", model.body_inertia[body], strict=True)}
    ET.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})


def _add_joint(robot: ET.Element, name: str, kind: str, parent: str, child: str, place: ET.Element) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    joint.append(place)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _add_limit(joint: ET.Element, lower: float, upper: float, torque: float, speed: float) -> None:
    numbers = {"lower": lower, "upper": upper, "effort": torque, "velocity": speed}
    ET.SubElement(joint, "limit", {name: f"{value:.9g}" for name, value in numbers.items()})


def _origin(pos: np.ndarray, quat: np.ndarray) -> ET.Element:
    """A frame; rpy turns about the fixed axes x, then y, then z: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, np.asarray(quat, dtype=float))
    turn = flat.reshape(3, 3)
    level = np.hypot(turn[0, 0], turn[1, 0])
    pitch = np.arctan2(-turn[2, 0], level)
    if level > 1e-9:
        roll, yaw = np.arctan2(turn[2, 1], turn[2, 2]), np.arctan2(turn[1, 0], turn[0, 0])
    else:  # roll and yaw turn about the same axis
        roll, yaw = np.arctan2(-turn[1, 2], turn[1, 1]), 0.0
    return ET.Element("origin", xyz=_text(pos), rpy=_text(np.array([roll, pitch, yaw])))


def _text(numbers: np.ndarray) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)
