"""Result of `yam-tune` for one arm, read from the file in the option `tuning`.

The file names an arm and an end effector, and contains their differences from the profiles. Each `*_95` is half the
width of a 95 % confidence interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lerobot_robot_yam.arm.config_checks import PAYLOAD_MOST_KG
from lerobot_robot_yam.arm.profile import EE_BODY, ArmProfile, Body, GripperProfile, Load
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import write_whole
from lerobot_robot_yam.system.strict_yaml import array_field, parse, read_yaml

_HEAD = "# What yam-tune has found out about one arm; SI units, one entry per joint. See docs/tuning.md.\n"
_SHIFT_MOST_M = 0.5  # maximum shift of a centre of mass, m: the length of the links
_FRICTION_MOST = 5.0  # maximum friction: Coulomb, Nm, and viscous, Nm s/rad


@dataclass(frozen=True, eq=False)
class Payload:
    """Load at the tool: mass, kg, and centre of mass (3,), m, in the frame of the tcp."""

    mass_kg: float = 0.0
    mass_kg_95: float = 0.0
    com_m: np.ndarray = array_field(3, default=(0, 0, 0))
    com_m_95: np.ndarray = array_field(3, default=(0, 0, 0))


@dataclass(frozen=True, eq=False)
class Tuning:
    """Weight and friction of one arm of n joints.

    Attributes:
        arm, gripper: names of the profiles.
        moment_kg_m: (n, 3) mass times centre of mass of each link in its own frame, minus the profile's value; see
            `gravity_terms`.
        gravity_factor: (n,) the same differences as factors on the profile's gravity torque per joint.
        coulomb_nm, viscous_nm_s: (n,) friction, Nm and Nm s/rad.
        payload: load at the tcp.
    """

    arm: str
    gripper: str
    moment_kg_m: np.ndarray = array_field(-1, 3)
    moment_kg_m_95: np.ndarray = array_field(-1, 3)
    gravity_factor: np.ndarray = array_field(-1)
    gravity_factor_95: np.ndarray = array_field(-1)
    coulomb_nm: np.ndarray = array_field(-1)
    coulomb_nm_95: np.ndarray = array_field(-1)
    viscous_nm_s: np.ndarray = array_field(-1)
    viscous_nm_s_95: np.ndarray = array_field(-1)
    payload: Payload = Payload()

    @property
    def load(self) -> Load:
        """Payload as a `Load`."""
        x, y, z = self.payload.com_m.tolist()
        return Load(payload_mass_kg=self.payload.mass_kg, payload_com_m=(x, y, z))

    def tuned(self, arm: ArmProfile, gripper: GripperProfile) -> tuple[ArmProfile, GripperProfile]:
        """Apply centres of mass and friction to copies of the profiles, and set their gravity factors to 1.

        Raises:
            ConfigError: the tuning is for another arm or end effector.
        """
        if (arm.name, gripper.name) != (self.arm, self.gripper) or len(self.moment_kg_m) != arm.joint_count:
            raise ConfigError(
                f"tuning is of arm {self.arm} with {self.gripper}, not of {arm.name} with {gripper.name}; run yam-tune"
            )
        links, moments = [body.name for body in arm.bodies if body.joint], list(self.moment_kg_m)
        last = {EE_BODY: moments.pop()}
        shifts = dict(zip(links, moments, strict=False))
        tuned = replace(arm, bodies=_shifted(arm.bodies, shifts), coulomb_friction_nm=self.coulomb_nm)
        return (
            replace(tuned, gravity_factor=np.ones(arm.joint_count)),
            replace(gripper, bodies=_shifted(gripper.bodies, last)),
        )


def load_tuning(path: str | Path) -> Tuning:
    """Read a tuning from its file. Raises ConfigError: the file cannot be read, or contains invalid values."""
    where = f"tuning {path}"
    tuning = parse(Tuning, read_yaml(Path(path)), where)
    counts = {name: len(value) for name, value in vars(tuning).items() if np.ndim(value)}
    if len(set(counts.values())) > 1:
        raise ConfigError(f"{where}: its lists need one entry per joint, and have {counts}")
    for name in ("coulomb_nm", "viscous_nm_s"):
        value = getattr(tuning, name)
        if (value < 0.0).any() or (value > _FRICTION_MOST).any():
            raise ConfigError(f"{where}: {name} takes numbers within 0 … {_FRICTION_MOST:g}")
    if not 0.0 <= tuning.payload.mass_kg <= PAYLOAD_MOST_KG:
        raise ConfigError(f"{where}: payload.mass_kg takes a mass within 0 … {PAYLOAD_MOST_KG:g} kg")
    return tuning


def save_tuning(path: Path, tuning: Tuning) -> None:
    """Write the file atomically. Raises ConfigError: the file cannot be written."""
    text = yaml.safe_dump(_plain(tuning), sort_keys=False, default_flow_style=None, width=110)
    try:
        write_whole(path, _HEAD + text)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error}") from error


def _plain(value: Any) -> Any:
    """Convert a dataclass to plain values, with numbers rounded to five places."""
    if is_dataclass(value):
        return {name: _plain(own) for name, own in vars(value).items()}
    return np.round(value, 5).tolist() if isinstance(value, np.ndarray | float) else value


def _shifted(bodies: Sequence[Body], moments: dict[str, np.ndarray]) -> tuple[Body, ...]:
    """Copy bodies with their centres of mass shifted by moment / mass."""
    found = []
    for body in bodies:
        moment = moments.get(body.name)
        if moment is not None and moment.any():
            shift = moment / body.inertial.mass_kg
            if np.abs(shift).max() > _SHIFT_MOST_M:
                raise ConfigError(
                    f"tuning: moment_kg_m puts the centre of mass of {body.name} {np.abs(shift).max():.2f} m from "
                    "where its profile has it; run yam-tune again"
                )
            body = replace(body, inertial=replace(body.inertial, com_m=body.inertial.com_m + shift))
        found.append(body)
    return tuple(found)
