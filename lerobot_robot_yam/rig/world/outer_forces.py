"""External influences on arms: pushes and hands, whose forces are summed, added masses, and contacts."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np

from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import BALLAST


class _Applied(NamedTuple):
    body: int
    site: int | None  # point of application; None for the body's centre of mass
    force_n: np.ndarray
    torque_nm: np.ndarray


_NO_TORQUE = np.zeros(3)


class OuterForces:
    """Forces (3,), N, and torques (3,), Nm, in world axes on bodies, stored per source."""

    def __init__(self, world: World):
        self._world = world
        self._applied: dict[str, _Applied] = {}

    def apply(
        self,
        source: str,
        body: int,
        force_n: np.ndarray,
        torque_nm: np.ndarray = _NO_TORQUE,
        site: int | None = None,
    ) -> None:
        """Set the force and torque of a source on a body from now on; replaces earlier ones of the same source."""
        before = self._applied.get(source)
        self._applied[source] = _Applied(body, site, force_n, torque_nm)
        if before is not None and before.body != body:
            self._add_up(before.body)
        self._add_up(body)

    def end(self, source: str) -> None:
        """Remove the force of a source. Idempotent."""
        before = self._applied.pop(source, None)
        if before is not None:
            self._add_up(before.body)

    def refresh(self) -> None:
        """Update the torques of forces applied at moving sites; must be called every few milliseconds."""
        for body in {applied.body for applied in self._applied.values() if applied.site is not None}:
            self._add_up(body)

    def force_n(self, source: str) -> np.ndarray:
        """Return the force (3,), N, of a source; zeros for an unknown source."""
        applied = self._applied.get(source)
        return np.zeros(3) if applied is None else applied.force_n

    def _add_up(self, body: int) -> None:
        data = self._world.data
        wrench = np.zeros(6)
        for applied in self._applied.values():
            if applied.body == body:
                wrench[:3] += applied.force_n
                wrench[3:] += applied.torque_nm
                if applied.site is not None:
                    wrench[3:] += np.cross(data.site_xpos[applied.site] - data.xipos[body], applied.force_n)
        data.xfrc_applied[body] = wrench


class Contact(NamedTuple):
    """Contact between an arm and another body: names of both bodies, point (3,) m, force (3,) N on the arm."""

    body: str
    other: str
    point_m: list[float]
    force_n: list[float]


def contacts_of(world: World, channel: str) -> Iterator[Contact]:
    """Yield the contacts between an arm and everything else in the last step."""
    model, data = world.model, world.data
    for index in range(data.ncon):
        contact = data.contact[index]
        first, second = (model.body(int(model.geom_bodyid[geom])).name for geom in contact.geom)
        arms = [name.partition("/")[0] == channel for name in (first, second)]
        if arms[0] == arms[1]:
            continue
        wrench = np.zeros(6)
        mujoco.mj_contactForce(model, data, index, wrench)
        on_second = contact.frame.reshape(3, 3).T @ wrench[:3]
        force: Any = on_second if arms[1] else -on_second
        names = (second, first) if arms[1] else (first, second)
        yield Contact(*names, contact.pos.tolist(), force.tolist())


def tool_bodies(world: World, channel: str) -> set[str]:
    """Return the bodies of an arm's tool: the body with the tcp frame, and its descendants."""
    model = world.model
    tool = int(model.site(f"{channel}/tcp_site").bodyid[0])
    found = {tool}
    for body in range(tool + 1, model.nbody):  # parents precede their children
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return {model.body(body).name for body in found}


class Ballast:
    """Payload and hand at an arm's tool; neither is part of the profile, nor therefore of the driver's model.

    Both are masses of a body that `world_model` attaches to the tool at its tcp frame.
    """

    def __init__(self, world: World, channel: str):
        self._model, self._body = world.model, world.model.body(f"{channel}/{BALLAST}").id
        self._payload_kg = self._hand_kg = 0.0

    def carry(self, payload_kg: float) -> None:
        """Attach a point mass to the tool; 0 removes it."""
        self._payload_kg = payload_kg
        self._weigh()

    def hold(self, hand_kg: float, fist_m: float) -> None:
        """Attach a hand with radius of gyration `fist_m` to the tool; 0 kg removes it."""
        self._hand_kg = hand_kg
        self._model.body_inertia[self._body] = hand_kg * fist_m**2
        self._weigh()

    def _weigh(self) -> None:
        model, mass_kg = self._model, self._payload_kg + self._hand_kg
        if mass_kg != model.body_mass[self._body]:
            model.body_mass[self._body] = mass_kg
            mujoco.mj_setConst(model, mujoco.MjData(model))
