"""Forces from outside on bodies of the world: pushes and hands, which add up, and contacts, which are read."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np

from lerobot_robot_yam.rig.world.world import World


class _Applied(NamedTuple):
    body: int
    site: int | None  # the force acts there; None: at the body's centre of mass
    force_n: np.ndarray
    torque_nm: np.ndarray


_NO_TORQUE = np.zeros(3)


class OuterForces:
    """What acts on bodies, by its source. Forces (3,) N and torques (3,) Nm in world axes."""

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
        """From now on a source does this to a body, instead of what it did before."""
        before = self._applied.get(source)
        self._applied[source] = _Applied(body, site, force_n, torque_nm)
        if before is not None and before.body != body:
            self._add_up(before.body)
        self._add_up(body)

    def end(self, source: str) -> None:
        """A source does nothing any more. Idempotent."""
        before = self._applied.pop(source, None)
        if before is not None:
            self._add_up(before.body)

    def refresh(self) -> None:
        """Have the forces that act at a site follow it; call every few milliseconds."""
        for body in {applied.body for applied in self._applied.values() if applied.site is not None}:
            self._add_up(body)

    def force_n(self, source: str) -> np.ndarray:
        """The force of a source, zeros without it."""
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
    """One contact of an arm with something else: names of both bodies, point (3,) m, force (3,) N on the arm."""

    body: str
    other: str
    point_m: list[float]
    force_n: list[float]


def contacts_of(world: World, channel: str) -> Iterator[Contact]:
    """The contacts of the last step between an arm and what does not belong to it."""
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
    """Names of the bodies of an arm's tool: the one that carries its frame, and what moves on that."""
    model = world.model
    tool = int(model.site(f"{channel}/tcp_site").bodyid[0])
    found = {tool}
    for body in range(tool + 1, model.nbody):  # a body comes after its parent
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return {model.body(body).name for body in found}
