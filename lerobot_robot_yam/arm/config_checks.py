"""Checks of the values in an `ArmConfig`: first the declared type of each field, then the range of the quantity.

Ranges that depend on the motors are checked in `profile_files`.
"""

import json
import math
import types
import typing
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.option import real
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_PATHS = ("calibration_path", "identity_path", "tuning")  # fields in which `~` is expanded
_TEXT_MAX = 100  # maximum length of a channel name, bytes: file names contain it
GRAVITY_FACTOR_MOST = 2.0  # maximum factor on the modelled gravity torque; the vendor uses 1.0 to 1.2
PAYLOAD_MOST_KG = 3.0  # maximum payload: outstretched, joint 2 of a YAM holds 2.1 kg, joint 3 of a big YAM 3.8 kg
_FRICTION_MOST_NM = 1.0  # maximum friction feedforward: too much moves a joint by itself; the vendor uses 0.06-0.3
_TOOL_M = 0.5  # maximum distance of a centre of mass from the tool's frame, m: the length of the arm's links
_FLOAT_SPEEDS_RAD_S = (0.5, 10.0)  # allowed floating speeds: slower resembles holding; motors limit at 10 and more
_TIMEOUTS_S = (0.02, 10.0)  # allowed command timeouts: from the fastest to the slowest stream of targets
_AGES_S = (0.02, 2.0)  # allowed age limits of a state: from a few ticks to a time in which the arm can move anywhere
_FORCES_N = (1.0, 200.0)  # allowed grip forces: from what a finger feels to four times the default
_RATE_MIN_HZ = 100.0  # minimum loop rate: the watchdog of the motors and the stand-by would treat a slower loop as dead
_RATE_MAX_HZ = 1000.0
_PER_JOINT = -1  # count for one number per joint; `ResolvedArm`, which has the profile, checks the number
_ABOVE_ZERO = math.nextafter(0.0, 1.0)
# Allowed accelerations: from one that needs 0.2 rad from 1.5 rad/s to rest, to one that no joint but the light ones of
# the wrist reaches: joint 3 of a YAM gets 80 rad/s² in its worst pose, joints 1 and 2 less. Poses limit it further.
_ACCELERATIONS_RAD_S2 = (5.0, 100.0)


def _one(what: str, low: float, high: float, unit: str) -> tuple[None, float, float, str]:
    return None, low, high, f"{what} within {low:g} … {high:g} {unit}"


def _each(high: float, unit: str = "") -> tuple[int, float, float, str]:
    return _PER_JOINT, 0.0, high, f"numbers within 0 … {high:g}{unit}, one per joint"


# Rule per field: how many numbers (None: one), minimum, maximum, and the accepted values in words. `profile_files` has
# the bounds that depend on the motors: gains, torques and speeds.
_NUMBERS: dict[str, tuple[int | None, float, float, str]] = {
    **dict.fromkeys(
        ("kp", "kd", "idle_kd", "torque_limit_nm"), (_PER_JOINT, 0.0, math.inf, "numbers from zero up, one per joint")
    ),
    "gravity_factor": _each(GRAVITY_FACTOR_MOST),
    "coulomb_friction_nm": _each(_FRICTION_MOST_NM, " Nm"),
    "effort_limit_nm": (_PER_JOINT, _ABOVE_ZERO, math.inf, "numbers above zero, one per joint"),
    "speed_limit_rad_s": (_PER_JOINT, _ABOVE_ZERO, math.inf, "one number above zero, or one per joint"),
    "acceleration_limit_rad_s2": (
        _PER_JOINT,
        *_ACCELERATIONS_RAD_S2,
        "one number within {:g} … {:g} rad/s², or one per joint".format(*_ACCELERATIONS_RAD_S2),
    ),
    "float_speed_rad_s": _one("a speed", *_FLOAT_SPEEDS_RAD_S, "rad/s"),
    "payload_mass_kg": _one("a mass", 0.0, PAYLOAD_MOST_KG, "kg"),
    "payload_com_m": (3, -_TOOL_M, _TOOL_M, f"three numbers within ±{_TOOL_M:g} m"),
    "base_tilt_rad": (2, -3.15, 3.15, "[roll, pitch] within a half turn, ±3.14"),
    "rest_q_rad": (_PER_JOINT, -math.inf, math.inf, "angles in rad, one per joint"),
    "gripper_stops_rad": (2, -math.inf, math.inf, "[closed, open] in motor radians"),
    "ee_inertia": (10, -math.inf, math.inf, "centre (3), quaternion (4) and moments (3)"),
    "command_timeout_s": _one("a time", *_TIMEOUTS_S, "s"),
    "max_state_age_s": _one("a time", *_AGES_S, "s"),
    "gripper_force_limit_n": _one("a force", *_FORCES_N, "N, or null for none"),
    **dict.fromkeys(
        ("gripper_speed_limit", "max_relative_target"), (None, _ABOVE_ZERO, math.inf, "a number above zero")
    ),
    **dict.fromkeys(("gripper_kp", "gripper_kd"), (None, 0.0, math.inf, "a number from zero up")),
    "rate_hz": (
        None,
        0.0,
        _RATE_MAX_HZ,
        f"a rate within {_RATE_MIN_HZ:g} … {_RATE_MAX_HZ:g}, or 0 for as fast as the wire allows",
    ),
}


def check(config: Any) -> None:
    """Check and convert a config in place: numbers to floats, sequences to lists, `~` in paths expanded.

    Raises:
        ConfigError: a value has a wrong type or range; the message names arm, field and accepted values.
    """
    if config.channel == "":
        raise ConfigError(f"{config.name}: no CAN channel given; set `channel`, such as can_follower_l")
    hints = typing.get_type_hints(type(config))
    for field in fields(config):
        value = getattr(config, field.name)
        kinds = _members(hints[field.name])
        if value is None:
            if type(None) not in kinds:
                raise _refusal(config, field.name, "a value")
        elif float in kinds or list in kinds:
            setattr(config, field.name, _numbers(config, field.name, value, kinds))
        elif bool in kinds and not isinstance(value, bool):
            raise _refusal(config, field.name, "true or false")
        elif any(isinstance(kind, type) and is_dataclass(kind) and not isinstance(value, kind) for kind in kinds):
            raise _refusal(config, field.name, "a mapping of its fields")
        elif dict in kinds:
            _check_options(config, field.name, value)
        elif str in kinds:
            _check_text(config, field.name, value)
            if field.name in _PATHS:
                setattr(config, field.name, str(user_path(value)))
        elif choices := [kind for kind in kinds if isinstance(kind, str)]:
            if not isinstance(value, str) or value not in choices:
                raise _refusal(config, field.name, " or ".join(map(repr, choices)))
    if 0.0 < config.rate_hz < _RATE_MIN_HZ:
        raise _refusal(config, "rate_hz", _NUMBERS["rate_hz"][-1])
    if config.ee_inertia is not None and (min(config.ee_inertia[7:]) <= 0.0 or not any(config.ee_inertia[3:7])):
        raise _refusal(config, "ee_inertia", "a quaternion that is not zero, and moments above zero")
    if config.ee_inertia is not None and max(map(abs, config.ee_inertia[:3])) > _TOOL_M:
        raise _refusal(config, "ee_inertia", f"a centre within ±{_TOOL_M:g} m")


def check_switches(device: str, options: Any) -> None:
    """Check that no boolean of a device's config is None, which LeRobot's parser would accept.

    Raises:
        ConfigError: a boolean field is None; the message names device and field.
    """
    for name, hint in typing.get_type_hints(type(options)).items():
        if hint is bool and not isinstance(value := getattr(options, name), bool):
            raise ConfigError(f"{device}: {name} takes true or false; got {value!r}")


def _members(hint: Any) -> tuple[Any, ...]:
    """List the types in a hint, and the values in a `Literal`: `float | None` becomes (float, NoneType)."""
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        return tuple(kind for part in typing.get_args(hint) for kind in _members(part))
    if typing.get_origin(hint) is typing.Literal:
        return typing.get_args(hint)
    return (typing.get_origin(hint) or hint,)


def _numbers(config: Any, key: str, value: Any, kinds: tuple[Any, ...]) -> float | list[float]:
    default = (None, -math.inf, math.inf, "a number" if float in kinds else "a list of numbers")
    count, low, high, takes = _NUMBERS.get(key, default)
    several = isinstance(value, Sequence | np.ndarray)
    if several and (list not in kinds or isinstance(value, str | bytes) or getattr(value, "ndim", 1) != 1):
        raise _refusal(config, key, takes)
    if not several and float not in kinds:
        raise _refusal(config, key, takes)
    numbers = [real(item) for item in value] if several else [real(value)]
    if several and count not in (None, _PER_JOINT, len(numbers)):
        raise _refusal(config, key, takes)
    if not all(math.isfinite(x) and low <= x <= high for x in numbers):
        raise _refusal(config, key, takes)
    return numbers if several else numbers[0]


def _check_text(config: Any, key: str, value: Any) -> None:
    if not isinstance(value, str) or not value or not value.isprintable():
        raise _refusal(config, key, "a text")
    if key == "channel" and len(value.encode()) > _TEXT_MAX:
        raise _refusal(config, key, f"a text of at most {_TEXT_MAX} bytes")


def _check_options(config: Any, key: str, value: Any) -> None:
    """Check that CAN options can be encoded as JSON for the control process, and be keyword arguments there."""
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
        raise _refusal(config, key, "names and values, such as {rig: auto}")
    taken = sorted({"interface", "channel"} & value.keys())
    if taken:
        raise ConfigError(f"{config.name}: {key} has {taken}, which are fields of their own")
    try:
        json.dumps(value)
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigError(f"{config.name}: {key} takes plain values only ({error})") from error


def _refusal(config: Any, key: str, takes: str) -> ConfigError:
    return ConfigError(f"{config.name}: {key} takes {takes}; got {getattr(config, key)!r}")
