"""Loading and checking of arm and gripper profiles, from `profiles/` or from the user's YAML files.

`load_arm("yam")`, `load_gripper("linear_4310")`. The name may also be the path of a YAML file, and `overrides`
replaces any field: `load_arm("yam", {"kp": [...]})`.

Every number is checked against its range. The bounds are those of the command frames (`damiao.tables`), which motors
cannot exceed, or follow from the meaning (a mass is above zero, a lower limit below the upper one).
"""

import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import ARMS, GRIPPERS, NO_ARM, PROFILES
from lerobot_robot_yam.arm.config_checks import GRAVITY_FACTOR_MOST
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.arm.profile import ArmMotor, ArmProfile, Body, GripperMotor, GripperProfile, Limiter
from lerobot_robot_yam.damiao.motor_spec import MotorSpec, check_specs
from lerobot_robot_yam.damiao.tables import MotorType, motor_type
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.strict_yaml import merge, parse, read_yaml

_KP_LEAST = 1.0  # minimum stiffness, Nm/rad: an arm with less sinks
_KD_LEAST = 0.02  # minimum ratio of damping to kp, s: an arm with less oscillates; the maker uses 0.025 to 0.15
_TORQUE_LEAST = 0.1  # minimum torque limit as a fraction of the motor's range: less cannot hold an arm
_LEAST = 1e-9  # magnitude below which a divisor counts as zero
_ROUNDING = 1e-6  # relative rounding error of published moments of inertia
_FINGER_TRAVEL_M = (1e-3, 1.0)  # allowed finger travel, m, a divisor of the gearing; the maker has 0.040-0.048
_FORCE_MAPS = ("linear", "crank")


def load_arm(name: str | Path, overrides: Mapping[str, Any] | None = None) -> ArmProfile:
    """Load an arm's profile by name (`ARMS` or "none") or YAML path. Raises ConfigError: wrong name or value."""
    if name in (*ARMS, NO_ARM) and not overrides:
        return _shipped_arm(str(name))
    return _load("arm", ArmProfile, check_arm, (*ARMS, NO_ARM), name, overrides)


def load_gripper(name: str | Path, overrides: Mapping[str, Any] | None = None) -> GripperProfile:
    """Load an end effector's profile by name (`GRIPPERS`) or YAML path. Raises ConfigError: wrong name or value."""
    if name in GRIPPERS and not overrides:
        return _shipped_gripper(str(name))
    return _load("gripper", GripperProfile, check_gripper, GRIPPERS, name, overrides)


def _load[T](
    what: str,
    kind: type[T],
    check: Callable[[T, str], None],
    names: Sequence[str],
    name: str | Path,
    overrides: Mapping[str, Any] | None,
) -> T:
    if name in names:
        document = _packaged(f"{what}s", str(name))
    elif str(name).endswith((".yaml", ".yml")):
        document = read_yaml(Path(name))
    else:
        near = difflib.get_close_matches(str(name), names, 1)
        meant = f"did you mean '{near[0]}'? Known: " if near else "known: "
        raise ConfigError(f"unknown {what} '{name}'; {meant}{', '.join(names)}, or a path to a YAML profile")
    return _checked(what, kind, check, str(name), merge(document, overrides or {}))


@cache  # safe to share, since profiles and their arrays are read-only
def _shipped_arm(name: str) -> ArmProfile:
    return _checked("arm", ArmProfile, check_arm, name, _packaged("arms", name))


@cache
def _shipped_gripper(name: str) -> GripperProfile:
    return _checked("gripper", GripperProfile, check_gripper, name, _packaged("grippers", name))


def _checked[T](what: str, kind: type[T], check: Callable[[T, str], None], name: str, document: dict[str, Any]) -> T:
    profile = parse(kind, document, f"{what} '{name}'")
    check(profile, f"{what} '{name}'")
    return profile


@cache
def _packaged(folder: str, name: str) -> dict[str, Any]:
    return read_yaml(PROFILES / folder / f"{name}.yaml")


def check_arm(arm: ArmProfile, where: str) -> None:
    """Check an arm's profile or overrides. Raises ConfigError: a value is invalid; the message names the field."""
    n = arm.joint_count
    jointed = [body for body in arm.bodies if body.joint]
    lengths = {key: len(value) for key, value in vars(arm).items() if isinstance(value, np.ndarray) and len(value) != n}
    lengths |= {f"rest_q_rad.{g}": len(q) for g, q in arm.rest_q_rad.items() if len(q) != n}
    if lengths or len(jointed) != n:
        raise ConfigError(f"{where}: {n} motors, {len(jointed)} jointed bodies, wrong lengths {lengths}")
    _check_motors(arm.motors, where)
    _check_bodies(arm.bodies, where)
    _check_names(arm, [body.joint.name for body in arm.bodies if body.joint], where)
    rows = [motor_type(motor.type) for motor in arm.motors]
    torque_max = np.array([row.torque_max_nm for row in rows])
    position_max = np.array([row.position_max_rad for row in rows])
    lower, upper = arm.joint_limits_rad[:, 0], arm.joint_limits_rad[:, 1]
    ranges: dict[str, tuple[np.ndarray, float | np.ndarray, float | np.ndarray]] = {
        **{key: (getattr(arm, key), *bounds) for key, bounds in gain_ranges(rows, arm.kp).items()},
        "idle_kd": (arm.idle_kd, 0.0, np.array([row.kd_max for row in rows])),
        "gravity_factor": (arm.gravity_factor, 0.0, GRAVITY_FACTOR_MOST),
        "coulomb_friction_nm": (arm.coulomb_friction_nm, 0.0, torque_max),
        "joint_limits_rad": (arm.joint_limits_rad, -position_max[:, None], position_max[:, None]),
        "torque_limit_nm": (arm.torque_limit_nm, _TORQUE_LEAST * torque_max, torque_max),
        "armature_kg_m2": (arm.armature_kg_m2, 0.0, np.inf),
        "friction_nm": (arm.friction_nm, 0.0, np.inf),
    }
    for gripper, rest in arm.rest_q_rad.items():
        ranges[f"rest_q_rad.{gripper}"] = (rest, lower - RANGE_TOLERANCE_RAD, upper + RANGE_TOLERANCE_RAD)
    for key, (value, low, high) in ranges.items():
        if not ((value >= low) & (value <= high)).all():
            raise ConfigError(f"{where}: {key} {value.tolist()} is not within {_shown(low)} … {_shown(high)}")
    speed_max = np.array([row.velocity_max_rad_s for row in rows])
    if not ((arm.speed_limit_rad_s > 0.0) & (arm.speed_limit_rad_s <= speed_max)).all():
        raise ConfigError(
            f"{where}: speed_limit_rad_s must be above zero and at most the motors' {_shown(speed_max)} rad/s, "
            f"not {arm.speed_limit_rad_s.tolist()}"
        )
    if not (lower < upper).all():
        raise ConfigError(f"{where}: each row of joint_limits_rad is [lower, upper]: {arm.joint_limits_rad.tolist()}")


def gain_ranges(motors: Sequence[MotorType], kp: np.ndarray) -> dict[str, tuple[float | np.ndarray, np.ndarray]]:
    """Return the smallest and the largest kp (n,) of an arm's joints, and the kd (n,) that suit this `kp`."""
    most = [np.array([getattr(row, key) for row in motors]) for key in ("kp_max", "kd_max")]
    return {"kp": (_KP_LEAST, most[0]), "kd": (_KD_LEAST * kp, most[1])}


def _check_names(arm: ArmProfile, joints: list[str], where: str) -> None:
    """Check that joints are named in the order of the motors, and that all names refer to existing motors."""
    expected = [f"joint{i + 1}" for i in range(arm.joint_count)]
    if joints != expected:
        raise ConfigError(
            f"{where}: joints of the bodies are named {expected}, in the order of the motors, not {joints}"
        )
    motors = [motor.name for motor in arm.motors]
    folding = {f"folding.{role}": name for role, name in vars(arm.folding).items() if name is not None}
    for key, name in {**folding, **{f"zero_pose.{name}": name for name in arm.zero_pose}}.items():
        if motors and name not in motors:
            raise ConfigError(f"{where}: {key}: there is no motor {name!r}; write null where the arm has no such joint")
    if arm.gripper_can_id is not None and arm.gripper_can_id in [motor.can_id for motor in arm.motors]:
        raise ConfigError(f"{where}: gripper_can_id {arm.gripper_can_id} is the id of a joint's motor")


def check_gripper(gripper: GripperProfile, where: str) -> None:
    """Check an end effector's profile. Raises ConfigError: a value is invalid; the message names the field."""
    _check_bodies(gripper.bodies, where)
    fingers, motor, calibration = gripper.finger_joints, gripper.motor, gripper.calibration
    travel = gripper.finger_range_m
    parts = {"motor": motor, "calibration": calibration, "finger_range_m": travel}
    missing = [key for key, part in parts.items() if part is None]
    if len(missing) not in (0, len(parts)) or bool(fingers) == bool(missing):
        raise ConfigError(f"{where}: fingers, {', '.join(parts)} come together or not at all; {missing} missing")
    least, most = _FINGER_TRAVEL_M
    if not 0 <= len(fingers) <= 2 or (travel is not None and not least <= travel[1] - travel[0] <= most):
        raise ConfigError(f"{where}: one or two fingers move over {least:g} to {most:g} m, not {fingers} over {travel}")
    if motor is None or calibration is None:
        return
    _check_motors([motor], where)
    row = motor_type(motor.type)
    for key, value, least, most in (
        ("motor.kp", motor.kp, 0.0, row.kp_max),
        ("motor.kd", motor.kd, _KD_LEAST * motor.kp, row.kd_max),
        ("motor.idle_kd", motor.idle_kd, 0.0, row.kd_max),
        ("motor.torque_limit_nm", motor.torque_limit_nm, _TORQUE_LEAST * row.torque_max_nm, row.torque_max_nm),
        ("motor.armature_kg_m2", motor.armature_kg_m2, 0.0, np.inf),
        ("motor.friction_nm", motor.friction_nm, 0.0, np.inf),
        ("calibration.torque_nm", calibration.torque_nm, 0.0, row.torque_max_nm),
        ("calibration.pause_s", calibration.pause_s, 0.0, np.inf),
    ):
        if not least <= value <= most:
            raise ConfigError(f"{where}: {key} {value:g} is not within {least:g} … {most:g}")
    for key, value in (
        ("motor.speed_limit_per_s", motor.speed_limit_per_s),
        ("calibration.torque_nm", calibration.torque_nm),
        ("calibration.timeout_per_direction_s", calibration.timeout_per_direction_s),
        ("calibration.standstill_rad", calibration.standstill_rad),
        ("calibration.check_interval_s", calibration.check_interval_s),
        ("calibration.standstill_checks", calibration.standstill_checks),
        ("calibration.min_span_rad", calibration.min_span_rad),
    ):
        if value <= 0:
            raise ConfigError(f"{where}: {key} must be above zero, not {value:g}")
    closed, opened = calibration.nominal_stops_rad.tolist()
    fits = calibration.min_span_rad <= abs(opened - closed) <= calibration.max_span_rad
    if not fits or (closed > opened) != calibration.closed_is_larger:
        raise ConfigError(
            f"{where}: nominal_stops_rad [{closed:g}, {opened:g}] contradict closed_is_larger "
            f"{calibration.closed_is_larger} or the span {calibration.min_span_rad:g} … {calibration.max_span_rad:g}"
        )
    fastest = row.velocity_max_rad_s / gripper.stroke_rad
    if motor.speed_limit_per_s > fastest:
        raise ConfigError(
            f"{where}: motor.speed_limit_per_s {motor.speed_limit_per_s:g} is more than the motor's {fastest:.3g}"
        )
    if gripper.limiter is not None:
        _check_limiter(gripper.limiter, motor.kp, where)


def _check_limiter(limiter: Limiter, kp: float, where: str) -> None:
    """Check force map and sign, and that all divisors and thresholds of the limiter are above zero."""
    if limiter.force_map not in _FORCE_MAPS:
        raise ConfigError(f"{where}: limiter.force_map is one of {_FORCE_MAPS}, not {limiter.force_map!r}")
    lever = math.cos(limiter.close_angle_rad) - math.cos(limiter.open_angle_rad)
    positive = {
        "motor.kp": kp,
        "limiter.max_force_n": limiter.max_force_n,
        "limiter.clog_force_threshold_nm": limiter.clog_force_threshold_nm,
        "limiter.clog_speed_threshold_per_s": limiter.clog_speed_threshold_per_s,
        "limiter.gripper_stroke_m": limiter.gripper_stroke_m,
    }
    if limiter.force_map == "linear":
        positive["limiter.motor_stroke_rad"] = limiter.motor_stroke_rad
    else:
        positive["the lever from limiter.close_angle_rad to open_angle_rad"] = abs(lever)
    for key, value in positive.items():
        if value < _LEAST:
            raise ConfigError(f"{where}: {key} must be above zero for a force limiter, not {value:g}")
    if limiter.sign not in (-1.0, 1.0):
        raise ConfigError(f"{where}: limiter.sign is 1 or -1, not {limiter.sign:g}")


def _check_motors(motors: Sequence[ArmMotor | GripperMotor], where: str) -> None:
    check_specs([MotorSpec(motor.name, motor.can_id, motor.type) for motor in motors], where)
    for motor in motors:
        if motor.direction not in (-1, 1):
            raise ConfigError(f"{where}: direction of {motor.name} is 1 or -1, not {motor.direction}")


def _check_bodies(bodies: Iterable[Body], where: str) -> None:
    names = [body.name for body in bodies] + [body.joint.name for body in bodies if body.joint]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"{where}: bodies and joints need different names; {twice} appear twice")
    for body in bodies:
        inertial = body.inertial
        smallest, middle, largest = sorted(inertial.moments_kg_m2.tolist())
        if inertial.mass_kg <= 0.0 or smallest <= 0.0 or largest > (smallest + middle) * (1.0 + _ROUNDING):
            raise ConfigError(
                f"{where}: mass and moments of body {body.name} must be above zero, and no moment above the sum of the "
                f"others: {inertial.mass_kg:g} kg, {inertial.moments_kg_m2.tolist()} kg m²"
            )
        turns = {"quat_wxyz": body.quat_wxyz, "inertial.quat_wxyz": inertial.quat_wxyz}
        turns |= {f"site {site.name}": site.quat_wxyz for site in body.sites}
        if body.joint is not None:
            turns["joint.axis"] = body.joint.axis
        for key, vector in turns.items():
            if not _LEAST < float(np.linalg.norm(vector)) < np.inf:
                raise ConfigError(f"{where}: {key} of body {body.name} has no direction: {vector.tolist()}")


def _shown(bound: "float | np.ndarray") -> str:
    return str(np.round(np.ravel(bound), 3).tolist()) if isinstance(bound, np.ndarray) else f"{bound:g}"
