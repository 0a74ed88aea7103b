"""Records that caller and control loop share for a mobile base: its state (the loop writes) and the command.

SI units, all times on the monotonic clock. Motors in the order of `BaseProfile.motors`: steering and drive of each
caster in turn; then the rail's, if there is one.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any

import numpy as np

from lerobot_robot_yam.mobile.base_profile import BASE_MOTORS
from lerobot_robot_yam.mobile.rail_profile import RailScale, RailState
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.mobile.robot_parts import Part
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import BlockPair, Descriptors, Limited
from lerobot_robot_yam.system.shared_block import SharedBlock


class BaseRequest(IntEnum):
    """Requests of a caller, besides targets."""

    NONE = 0
    HOLD = 1  # brake and stay
    LAND = 2  # brake, cut torque
    REARM = 3
    RESET_ODOMETRY = 4
    HOME_RAIL = 5


BASE_STATE_DTYPE = np.dtype(
    [
        ("owner_pid", "u8"),  # process whose loop drives the base; changes when another process takes over
        ("stamp_s", "f8"),  # time of publication
        ("tick", "u8"),
        ("asked_s", "f8"),  # time of the oldest command that a motor's sample answers
        ("mode", "u1"),  # a `Mode`: HOLD at rest, TRACK while it follows targets
        ("limited", "u2"),  # a `Limited`
        ("motors", "u1"),
        ("pose", "f8", 3),  # odometry: m, m, rad since the last reset, heading not wrapped
        ("twist", "f8", 3),  # measured velocity in the odometry's frame
        ("body_twist", "f8", 3),  # measured velocity in the body's frame
        ("planned", "f8", 3),  # planned velocity in the odometry's frame
        ("slowed", "f8"),  # factor by which the target is slowed down, 0 … 1
        ("rail_homed", "u1"),
        ("rail_homing", "u1"),
        ("rail_m_per_rad", "f8"),  # NaN before homing
        ("rail_zero_rad", "f8"),  # angle of the rail's motor at height 0
        ("rail_upper", "u1"),  # whether the switches are triggered
        ("rail_lower", "u1"),
        ("rail_brake_on", "u1"),
        ("q", "f8", BASE_MOTORS),  # rad, in joint coordinates, unwrapped
        ("dq", "f8", BASE_MOTORS),  # rad/s
        ("tau", "f8", BASE_MOTORS),  # Nm
        ("motor_stamp_s", "f8", BASE_MOTORS),  # time of each motor's newest sample
        ("temp_mos_c", "f4", BASE_MOTORS),
        ("temp_rotor_c", "f4", BASE_MOTORS),
        ("fault", "u1", BASE_MOTORS),
        ("lost", "u8", BASE_MOTORS),
        ("target_sequence", "u8"),  # number of the newest target that was processed
        ("rail_sequence", "u8"),
        ("request_sequence", "u8"),  # number of the newest request that was executed or refused
        ("request_refused", "u1"),
        ("refusal", "S400"),
        ("trouble", "S40"),
        ("message", "S400"),
    ]
)

BASE_COMMAND_DTYPE = np.dtype(
    [
        ("target_stamp_s", "f8"),
        ("target_sequence", "u8"),
        ("values", "f8", 3),  # a twist, m/s, m/s, rad/s, or a pose, m, m, rad
        ("frame", "u1"),  # a `base_motion.Frame`
        ("pose", "u1"),  # whether `values` is a pose
        ("rail_stamp_s", "f8"),
        ("rail_sequence", "u8"),
        ("rail_value", "f8"),  # m/s or m
        ("rail_height", "u1"),  # whether `rail_value` is a height
        ("request_stamp_s", "f8"),
        ("request", "u1"),
        ("request_sequence", "u8"),
    ]
)


def _text(field: Any) -> str:
    return bytes(field).rstrip(b"\0").decode(errors="replace")


def _read(name: str, convert: Callable[[Any], Any]) -> Any:
    """Create a property that converts a field of the record."""
    return property(lambda self: convert(self._record[name]))


def _of_motors(name: str) -> Any:
    """Create a property that returns a copy of what a field says of each motor."""
    return property(lambda self: self._record[name][self._motors].copy())


def _copy(name: str, part: slice = slice(None)) -> Any:
    """Create a property that returns a copy of a field of the record, or of a part of it."""
    return property(lambda self: self._record[name][part].copy())


class BaseState:
    """State of a base, as measured at `stamp_s`.

    Args:
        record: a record of type BASE_STATE_DTYPE, which this object keeps.
    """

    mode: Mode = _read("mode", lambda value: Mode(int(value)))
    limited: Limited = _read("limited", lambda value: Limited(int(value)))
    pose: np.ndarray = _copy("pose")  # odometry (3,): x, y in m, heading in rad, not wrapped
    twist: np.ndarray = _copy("twist")  # measured velocity (3,) in the odometry's frame, m/s, m/s, rad/s
    body_twist: np.ndarray = _copy("body_twist")  # the same in the body's frame
    planned: np.ndarray = _copy("planned")  # planned velocity (3,) in the odometry's frame
    steer_rad: np.ndarray = _copy("q", slice(0, 8, 2))  # steering angles (4,), unwrapped
    steer_rad_s: np.ndarray = _copy("dq", slice(0, 8, 2))
    drive_rad: np.ndarray = _copy("q", slice(1, 8, 2))  # angles of the wheels (4,), unwrapped
    drive_rad_s: np.ndarray = _copy("dq", slice(1, 8, 2))
    slowed: float = _read("slowed", float)  # factor by which the target is slowed down, 0 … 1
    tau_nm: np.ndarray = _of_motors("tau")  # torques of the motors (n,), Nm
    temp_mos_c: np.ndarray = _of_motors("temp_mos_c")
    temp_rotor_c: np.ndarray = _of_motors("temp_rotor_c")
    asked_s: float = _read("asked_s", float)  # time of the oldest command that a sample answers
    published_s: float = _read("stamp_s", float)  # time at which the control loop wrote this state
    tick: int = _read("tick", int)
    answered: int = _read("request_sequence", int)  # number of the newest request that was executed or refused
    message: str = _read("message", _text)  # why the base is in its mode; empty when all is well

    def __init__(self, record: np.ndarray):
        self._record = record
        self._motors = slice(int(record["motors"]))

    def __repr__(self) -> str:
        x, y, theta = self.pose.tolist()
        wrong = f", {self.trouble}: {self.message}" if self.trouble else ""
        return f"<BaseState {self.mode.name} x={x:.3f} y={y:.3f} m theta={theta:.3f} rad{wrong}>"

    @property
    def rail(self) -> RailState | None:
        """State of the rail; None without one."""
        record = self._record
        if self._motors.stop < BASE_MOTORS:
            return None
        q, dq, tau = (float(record[name][-1]) for name in ("q", "dq", "tau"))
        scale = RailScale(float(record["rail_m_per_rad"]), float(record["rail_zero_rad"]))
        flags = {name: bool(record[f"rail_{name}"]) for name in ("homed", "homing", "upper", "lower", "brake_on")}
        return RailState(scale.height(q), dq * scale.metres_per_rad, q=q, dq=dq, tau=tau, **flags)

    @property
    def fault(self) -> tuple[int, ...]:
        """Per motor, code of `damiao.tables.Fault`."""
        return tuple(self._record["fault"][self._motors].tolist())

    @property
    def stamp_s(self) -> float:
        """Time of the oldest sample of a motor."""
        return float(self._record["motor_stamp_s"][self._motors].min())

    @property
    def refusal(self) -> str | None:
        """Reason for which the newest request was refused; None if it was not."""
        return _text(self._record["refusal"]) if self._record["request_refused"] else None

    @property
    def trouble(self) -> Trouble | None:
        """Fault of the base; None when all is well."""
        text = _text(self._record["trouble"])
        return Trouble(text) if text else None


def map_blocks(part: Part, descriptors: Descriptors) -> BlockPair:
    """Map the memory that the caller of an arm or a base has allocated."""
    if not isinstance(part, ResolvedBase):
        return BlockPair.of(descriptors)
    return BlockPair(
        SharedBlock(None, BASE_STATE_DTYPE, create=True, descriptor=descriptors.states),
        SharedBlock(None, BASE_COMMAND_DTYPE, create=False, descriptor=descriptors.commands),
    )
