"""Registration of this package's types with LeRobot, without importing LeRobot into programs that do not use it.

`lerobot.robots.config` alone takes seconds and loads torch, and this package's processes (control loop, virtual rig)
import this module too. Therefore each config module is imported right after the LeRobot module with its registry: at
once if that LeRobot module is already loaded, otherwise as soon as a LeRobot command loads it.

Other plugins use some of the same type names. A type whose name is taken is registered under its fallback name, if
it has one.

Registration also shows the messages of `start_messages`.
"""

import importlib
import logging
from collections.abc import Callable
from types import ModuleType
from typing import Any

import wrapt

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.start_messages import refuse_unreadable, shorten_page_about_ffmpeg, warn_if_newer
from lerobot_robot_yam.system.other_plugins import distribution_of, is_foreign, mixture

# LeRobot module with a registry → this package's modules that register types in it
REGISTRIES = {
    "lerobot.robots.config": ("lerobot_robot_yam.config_yam_follower",),
    "lerobot.teleoperators.config": (
        "lerobot_teleoperator_yam.config_yam_leader",
        "lerobot_teleoperator_yam.config_yam_hand_guide",
        "lerobot_teleoperator_yam.config_yam_passive_leader",
        "lerobot_teleoperator_yam.config_yam_gamepad",
    ),
    "lerobot.envs.configs": ("lerobot_robot_yam.config_yam_env",),
    "lerobot.cameras.configs": ("lerobot_robot_yam.config_yam_camera", "lerobot_robot_yam.config_yam_realsense"),
    "lerobot.rollout.configs": ("lerobot_strategy_yam.config_yam_dagger",),
    "lerobot.configs.policies": ("lerobot_robot_yam.face.openpi.configuration_openpi",),
}
# module of this package → its module whose configs extend the former's, and which is imported right after it: a user's
# program may import the former first, and LeRobot's registry is loaded in the midst of that import
EXTENSIONS = {
    "lerobot_robot_yam.config_yam_follower": "lerobot_robot_yam.config_yam_mobile",
    "lerobot_teleoperator_yam.config_yam_leader": "lerobot_teleoperator_yam.config_yam_mobile_leader",
}

logger = logging.getLogger(__name__)
_registering: set[str] = set()  # modules that have called `register_as`: this package's, not another plugin's


def register() -> None:
    """Register this package's types with LeRobot's registries: with loaded ones at once, with the others later.

    Raises:
        ConfigError: another distribution has overwritten files of this package.
    """
    for name in REGISTRIES:
        wrapt.register_post_import_hook(lambda module: register_types(module.__name__), name)
    for name in EXTENSIONS:
        wrapt.register_post_import_hook(lambda module: _register_types_of(EXTENSIONS[module.__name__]), name)


def register_types(lerobot_module: str) -> None:
    """Register this package's types with the registry of `lerobot_module`, which is loaded.

    Raises:
        ConfigError: another distribution has overwritten files of this package.
    """
    warn_if_newer()
    if not _registering:  # once, before the first type
        refuse_unreadable()
    shorten_page_about_ffmpeg()
    for name in REGISTRIES[lerobot_module]:
        _register_types_of(name)


def _register_types_of(name: str) -> None:
    try:
        module = importlib.import_module(name)
    except Exception as error:
        if name in _registering or not is_foreign(name):
            raise
        raise ConfigError("; ".join(mixture(name))) from error
    if name not in _registering and not _is_initialising(module):
        raise ConfigError("; ".join(mixture(name)))


def register_as[C: type](registry: Any, name: str, spare: str | None = None) -> Callable[[C], C]:
    """Return the class decorator that enters a config class of this package into a LeRobot registry.

    Args:
        registry: LeRobot's base class of such configs.
        name: name of the type.
        spare: fallback name, used if another plugin has already registered `name`; None: no fallback.
    """

    def decorate(config_class: C) -> C:
        _registering.add(config_class.__module__)
        known = registry.get_known_choices()
        if name not in known:
            registry.register_subclass(name, config_class)
        elif (holder := known[name]).__module__ != config_class.__module__:
            instead = f"use {spare!r}" if spare else "uninstall it to use ours"
            owner = distribution_of(holder.__module__)
            logger.warning("the LeRobot type %r is that of %s, not of the YAM driver; %s", name, owner, instead)
            if spare and spare not in known:
                registry.register_subclass(spare, config_class)
        return config_class

    return decorate


def _is_initialising(module: ModuleType) -> bool:
    return bool(getattr(getattr(module, "__spec__", None), "_initializing", False))
