"""Deviations of a simulated arm from its profile; the driver knows only the profile."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lerobot_robot_yam.arm.profile import ArmProfile, Body, GripperProfile
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.strict_yaml import array_field


@dataclass(frozen=True, eq=False)
class Deviation:
    """Differences between one arm of the scene, with n joints, and its profiles.

    Attributes:
        mass: link name → factor on the link's mass.
        centre: link name → factors (3,) on the coordinates of the link's centre of mass.
        friction: (n,) factors on the joints' dry friction, which then holds as firmly as real friction.
        viscous_nm_s: (n,) viscous friction, Nm s/rad.
        payload_mass_kg, payload_com_m: mass and centre of mass, (3,) m in the tcp frame, of a payload at the tool.
    """

    mass: dict[str, float] | None = None
    centre: dict[str, np.ndarray] | None = array_field(3, default=None)
    friction: np.ndarray | None = array_field(-1, default=None)
    viscous_nm_s: np.ndarray | None = array_field(-1, default=None)
    payload_mass_kg: float = 0.0
    payload_com_m: np.ndarray = array_field(3, default=(0, 0, 0))

    def check(self, arm: ArmProfile, gripper: GripperProfile, where: str) -> None:
        """Raise ConfigError if a name, length or value does not match the arm."""
        links = [body.name for body in (*arm.bodies, *gripper.bodies)]
        unknown = sorted({*(self.mass or ()), *(self.centre or ())} - set(links))
        if unknown:
            raise ConfigError(f"{where}: deviation names the links {unknown}; there are {', '.join(links)}")
        for key in ("friction", "viscous_nm_s"):
            value = getattr(self, key)
            if value is not None and (len(value) != arm.joint_count or (value < 0.0).any()):
                raise ConfigError(f"{where}: deviation.{key} takes {arm.joint_count} numbers from zero up")
        if min((self.mass or {}).values(), default=1.0) <= 0.0 or self.payload_mass_kg < 0.0:
            raise ConfigError(f"{where}: deviation: factors of masses are above zero, and a payload is not below")

    def apply(self, arm: ArmProfile, gripper: GripperProfile) -> tuple[ArmProfile, GripperProfile]:
        """Return the profiles from which the rig builds the arm."""
        mass, centre = self.mass or {}, self.centre or {}
        rubs = arm.friction_nm if self.friction is None else arm.friction_nm * self.friction
        return (
            replace(arm, bodies=_changed(arm.bodies, mass, centre), friction_nm=rubs),
            replace(gripper, bodies=_changed(gripper.bodies, mass, centre)),
        )


def _changed(bodies: Collection[Body], mass: Mapping[str, float], centre: Mapping[str, np.ndarray]) -> tuple[Body, ...]:
    found = []
    for body in bodies:
        own, factor = body.inertial, mass.get(body.name, 1.0)
        inertial = replace(
            own,
            mass_kg=own.mass_kg * factor,
            com_m=own.com_m * centre.get(body.name, 1.0),
            moments_kg_m2=own.moments_kg_m2 * factor,
        )
        found.append(replace(body, inertial=inertial))
    return tuple(found)
