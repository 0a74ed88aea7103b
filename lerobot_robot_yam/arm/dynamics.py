"""Rigid-body dynamics of an arm at loop rate: torques as functions of q, dq and ddq.

Gravity torque is inverse dynamics at rest, tau = g(q): recursive Newton–Euler (RNE) with zero velocity and
acceleration. Kinematics, centres of mass and RNE take a few microseconds; `mj_forward` would also run collision
detection and constraints.
"""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from lerobot_robot_yam.arm.model import base_quat, build_spec
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile, Load
from lerobot_robot_yam.system.few_values import any_of


class GravityModel:
    """Rigid-body model of an arm with its end effector. n joints (0 without an arm); the fingers stay closed.

    Not thread-safe: each thread needs its own model.
    """

    def __init__(
        self,
        arm: str | Path | ArmProfile,
        gripper: str | Path | GripperProfile,
        *,
        load: Load | None = None,
        tilt_rad: Sequence[float] = (0.0, 0.0),
        **load_fields,
    ):
        """Build the model. `load`, or its fields as keywords: payload_mass_kg, payload_com_m, ee_mass_kg, ee_inertia.

        tilt_rad: [roll, pitch] of the base, see `model.base_quat`.
        """
        arm, gripper = resolve_profiles(arm, gripper)
        self.joint_count = arm.joint_count
        self.model = build_spec(arm, gripper, load=load or Load(**load_fields), visuals=False).compile()
        if any(tilt_rad):
            back = base_quat(0.0, tilt_rad) * [1, -1, -1, -1]
            mujoco.mju_rotVecQuat(self.model.opt.gravity, self.model.opt.gravity.copy(), back)
        self._data = mujoco.MjData(self.model)
        n, data = self.joint_count, self._data
        self._qpos, self._qvel, self._qacc = data.qpos[:n], data.qvel[:n], data.qacc[:n]  # views
        self._cvel, self._cdof_dot = data.cvel, data.cdof_dot  # views
        self._tau = np.zeros(self.model.nv)
        self._tcp = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, "tcp_site")

    def torque(self, q: np.ndarray) -> np.ndarray:
        """Compute the torques (n,) Nm that balance gravity at `q` (n,) rad, without the profile's gravity factor."""
        self._move(q)
        mujoco.mj_rne(self.model, self._data, 0, self._tau)
        return self._tau[: self.joint_count].copy()

    def torques(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute g(q), C(q, dq) dq and M(q) ddq, (n,) Nm each, of the links without rotors; rad, rad/s, rad/s²."""
        data, tau = self._data, self._tau[: self.joint_count]
        holding = self.torque(q)
        if not (any_of(dq != 0.0) or any_of(ddq != 0.0)):
            return holding, np.zeros_like(holding), np.zeros_like(holding)
        self._qvel[:], self._qacc[:] = dq, ddq
        mujoco.mj_comVel(self.model, data)
        mujoco.mj_rne(self.model, data, 0, self._tau)
        moving = tau.copy()
        mujoco.mj_rne(self.model, data, 1, self._tau)
        accelerating = tau - moving
        self._qvel[:] = self._cvel[:] = self._cdof_dot[:] = 0.0  # `torque` assumes rest, and a NaN would persist
        return holding, moving - holding, accelerating

    def torque_per_kg(self, q: np.ndarray) -> np.ndarray:
        """Compute the torques (n,) Nm that a load at the tool adds per kg, at `q` (n,) rad: −J(q)ᵀ g."""
        self._move(q)
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self._data, jacobian, None, self._tcp)
        per_kg: np.ndarray = -(self.model.opt.gravity @ jacobian)[: self.joint_count]
        return per_kg

    def _move(self, q: np.ndarray) -> None:
        self._qpos[:] = q
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)
