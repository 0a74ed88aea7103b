"""A leader's handle as a stick: while its drive button is held, its way from where it was pressed is a velocity.

    deflection = (p − p₀, ψ − ψ₀) / full deflection        p: position of the handle, ψ: its turn about the vertical

Position and turn are those in the frame of the leader's base, whose +x is forward.
"""

import math

import numpy as np

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.arm.tool_pose import rotation_vector
from lerobot_robot_yam.face.driving.base_drive import VALID_S, Asked, shaped
from lerobot_robot_yam.face.operator_keys.handle_buttons import BUTTONS, RisingEdges
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode

_FULL = np.array([0.12, 0.12, 0.6, 0.12])  # full deflection of x, y, theta, height: m, m, rad, m
_DEAD_ZONE = 0.15  # share of the full deflection; a floating handle trembles
_EXPO = 0.3


class HandleDrive:
    """Handle of one leader.

    Args:
        name: the leader's name, for messages.
        models: profiles of the leader.
        button: name of the drive button, "top" or "bottom".
        rail: whether its way up and down moves a rail.

    Attributes:
        holds: whether the button is held: the handle drives the base, and not its follower.
    """

    def __init__(self, name: str, models: tuple[ArmProfile, GripperProfile], button: str, rail: bool):
        self._name, self._number = name, BUTTONS.index(button)
        self._full = _FULL if rail else np.where(np.arange(4) == 3, np.inf, _FULL)
        self._kinematics = YamKinematics(*models)
        self._origin: np.ndarray | None = None
        self._edges = RisingEdges()
        self._seen_s = math.inf  # time of the state of the last call

    @property
    def holds(self) -> bool:
        return self._origin is not None

    def forget(self) -> None:
        """Begin anew, with the button released."""
        self._origin, self._edges = None, RisingEdges()

    def asked(self, state: ArmState) -> Asked:
        """Return what the handle asks. state: fresh state of its leader."""
        if state.published_s - self._seen_s > VALID_S:  # what happened meanwhile, such as a stop, is not known
            self._origin = None
        self._seen_s = state.published_s
        down = None if state.trigger is None else state.buttons[self._number]
        begins = bool(self._edges.pressed({"drive": down}))
        if self._origin is not None and down is None:
            self._origin = None
            return Asked(trouble=f"the handle of {self._name} is silent")
        if not down or state.mode is not Mode.FLOAT:  # only a person's hand drives
            self._origin = None
            return Asked()
        pose = self._kinematics.fk(state.q)
        if begins:
            self._origin = pose
        if self._origin is None:
            return Asked()
        turn = rotation_vector(pose[:3, :3] @ self._origin[:3, :3].T)[2]
        way = pose[:3, 3] - self._origin[:3, 3]
        ratios = np.clip(np.array([way[0], way[1], turn, way[2]]) / self._full, -1.0, 1.0)
        x, y, theta, height = (shaped(ratio, _DEAD_ZONE, _EXPO) for ratio in ratios.tolist())
        return Asked((x, y, theta, height))
