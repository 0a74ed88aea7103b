"""Looks of a world that are drawn from a seed: light, colours and the cameras' poses. Only pictures know of them.

A policy that has seen many looks depends less on any of them. The same seed gives the same look.
"""

from collections.abc import Iterable

import mujoco
import numpy as np

_LIGHT_TURN = 0.30  # of a direction's components, whose vertical one is 1
_LIGHT_LEVEL = 0.25  # parts of the level
_HEADLIGHT_LEVEL = 0.12
_WARMTH = 0.06  # red more, blue less
_SCENERY_COLOUR, _THING_COLOUR = 0.10, 0.05  # of 1, in all channels alike; `_HUE` of it in each for itself
_CAMERA_M, _CAMERA_RAD = 0.02, 0.05  # in each axis
_HUE = 0.4
_ON_AN_ARM = 0.5  # as much, of cameras that an arm carries


_FIELDS = ("light_dir", "light_diffuse", "geom_rgba", "cam_pos", "cam_quat")


class Look:
    """The usual look of a model, and others near it.

    Args:
        model: whose lights, colours and cameras are changed.
        amount: 0 … 1, of the spreads above.
        things: bodies whose colours vary a little, as colours tell things apart.
        scenery: bodies whose colours vary more.
    """

    def __init__(self, model: mujoco.MjModel, amount: float, things: Iterable[str], scenery: Iterable[str]):
        self._model, self._amount = model, amount
        self._colour_spread = np.zeros((model.nbody, 1))
        for names, width in ((things, _THING_COLOUR), (scenery, _SCENERY_COLOUR)):
            for name in names:
                self._colour_spread[model.body(name).id] = width
        self._usual = {key: getattr(model, key).copy() for key in _FIELDS}
        head = model.vis.headlight
        self._ambient, self._diffuse = head.ambient.copy(), head.diffuse.copy()

    def take(self, seed: int) -> None:
        """Change the model to the look of this seed."""
        model, usual = self._model, self._usual
        random = np.random.default_rng(seed)

        def drawn(width: float | np.ndarray, *shape: int) -> np.ndarray:
            spread: np.ndarray = self._amount * width * random.uniform(-1.0, 1.0, shape)
            return spread

        direction = usual["light_dir"] / -usual["light_dir"][:, 2:]
        direction[:, :2] += drawn(_LIGHT_TURN, model.nlight, 2)
        model.light_dir[:] = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        tint = 1.0 + drawn(_WARMTH, 1) * np.array([1.0, 0.0, -1.0])
        model.light_diffuse[:] = usual["light_diffuse"] * (1.0 + drawn(_LIGHT_LEVEL, model.nlight, 1)) * tint
        model.vis.headlight.ambient[:] = self._ambient * (1.0 + drawn(_HEADLIGHT_LEVEL, 1)) * tint
        model.vis.headlight.diffuse[:] = self._diffuse * (1.0 + drawn(_HEADLIGHT_LEVEL, 1))
        shade, hue = drawn(self._colour_spread, model.nbody, 1), drawn(_HUE * self._colour_spread, model.nbody, 3)
        colours = usual["geom_rgba"][:, :3] + (shade + hue)[model.geom_bodyid]
        model.geom_rgba[:, :3] = np.clip(colours, 0.0, 1.0)
        for camera, body in enumerate(model.cam_bodyid):
            part = _ON_AN_ARM if body else 1.0
            model.cam_pos[camera] = usual["cam_pos"][camera] + drawn(part * _CAMERA_M, 3)
            quat = usual["cam_quat"][camera].copy()
            mujoco.mju_quatIntegrate(quat, drawn(part * _CAMERA_RAD, 3), 1.0)
            model.cam_quat[camera] = quat
