"""Masses that an arm's profile, and so the driver's model, does not know of."""

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.world.world import World

_FIELDS = ("body_mass", "body_ipos", "body_iquat", "body_inertia", "body_sameframe", "body_simple")


class Ballast:
    """A payload at an arm's tool and factors on its links' masses, changed while the world runs."""

    def __init__(self, world: World, channel: str):
        model = world.model
        self._model = model
        site = model.site(f"{channel}/tcp_site")
        self._tool, self._point = int(site.bodyid[0]), site.pos.copy()
        names = [model.body(b).name.partition("/") for b in range(model.nbody)]
        self._bodies = {name: body for body, (arm, _, name) in enumerate(names) if arm == channel}
        self._built = {field: getattr(model, field).copy() for field in _FIELDS}
        self._payload_kg = 0.0
        self._factors: dict[str, float] = {}

    def carry(self, payload_kg: float) -> None:
        """Put a point mass at the tool, 0 to take it away."""
        self._payload_kg = payload_kg
        self._apply()

    def scale(self, link: str, factor: float) -> None:
        """Multiply mass and inertia of a link of the profile.

        Raises:
            ConfigError: no such link.
        """
        if link not in self._bodies:
            raise ConfigError(f"the arm has no body {link!r}; it has {', '.join(self._bodies)}")
        self._factors[link] = factor
        self._apply()

    def repair(self) -> None:
        """Restore the masses of the profile."""
        if self._payload_kg or self._factors:
            self._payload_kg, self._factors = 0.0, {}
            self._apply()

    def _apply(self) -> None:
        model, bodies = self._model, list(self._bodies.values())
        for field, built in self._built.items():
            getattr(model, field)[bodies] = built[bodies]
        for link, factor in self._factors.items():
            model.body_mass[self._bodies[link]] *= factor
            model.body_inertia[self._bodies[link]] *= factor
        if self._payload_kg:
            self._add_point_mass(self._tool, self._payload_kg, self._point)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def _add_point_mass(self, body: int, mass_kg: float, at_m: np.ndarray) -> None:
        """Mass, centre and inertia of a body together with a point mass at `at_m` (3,) in its frame."""
        model = self._model
        old_kg, centre = float(model.body_mass[body]), model.body_ipos[body].copy()
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        axes = rotation.reshape(3, 3)
        arm = at_m - centre
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += old_kg * mass_kg / (old_kg + mass_kg) * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        moments, vectors = np.linalg.eigh(inertia)
        vectors[:, 2] *= np.linalg.det(vectors)  # right-handed
        model.body_mass[body] = old_kg + mass_kg
        model.body_ipos[body] = centre + mass_kg / (old_kg + mass_kg) * arm
        model.body_inertia[body] = moments
        mujoco.mju_mat2Quat(model.body_iquat[body], vectors.ravel())
        # Neither the body's frame nor that of anything on it is the inertia's any more.
        model.body_sameframe[body] = model.body_simple[body] = 0
        model.geom_sameframe[model.geom_bodyid == body] = 0
        model.site_sameframe[model.site_bodyid == body] = 0
