"""Our types in LeRobot's registries, without importing LeRobot where it is not used.

`lerobot.robots.config` alone takes seconds and loads torch, and our own processes (control loop, virtual rig) import
this package too. So each of our config modules is imported right after the LeRobot module that holds its registry: at
once if that is loaded already, else by an import hook. Each LeRobot command loads the registries that it needs.

Other plugins use some of our names. So each device has a spare name, and a name that is taken costs only that name.

The same moment serves the messages of `start_messages`.
"""

import importlib
import importlib.abc
import importlib.util
import logging
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.start_messages import refuse_unreadable, shorten_page_about_ffmpeg, warn_if_newer
from lerobot_robot_yam.system.other_plugins import distribution_of, is_foreign, mixture

# LeRobot's modules that hold a registry, and our modules that register types there.
REGISTRIES = {
    "lerobot.robots.config": (
        "lerobot_robot_yam.config_yam_follower",
        "lerobot_robot_yam.config_yam_remote",
        "lerobot_robot_yam.config_yam_rig",
    ),
    "lerobot.teleoperators.config": (
        "lerobot_teleoperator_yam.config_yam_leader",
        "lerobot_teleoperator_yam.config_yam_hand_guide",
        "lerobot_teleoperator_yam.config_yam_passive_leader",
        "lerobot_teleoperator_yam.config_yam_remote_leader",
        "lerobot_teleoperator_yam.config_yam_rig_leaders",
    ),
    "lerobot.envs.configs": ("lerobot_robot_yam.config_yam_env",),
    "lerobot.cameras.configs": ("lerobot_robot_yam.config_yam_camera", "lerobot_robot_yam.config_yam_realsense"),
    "lerobot.rollout.configs": ("lerobot_strategy_yam.config_yam_dagger",),
    "lerobot.configs.policies": ("lerobot_robot_yam.face.openpi.configuration_openpi",),
}

logger = logging.getLogger(__name__)
_registering: set[str] = set()  # modules that have called `register_as`, so ours, not another plugin's


def register() -> None:
    """Register our types with LeRobot's registries, loaded now or later.

    Raises:
        ConfigError: another distribution has put its own files over ours.
    """
    waiting = set(REGISTRIES)
    for name in REGISTRIES:
        module = sys.modules.get(name)
        if module is not None and not _is_initialising(module):
            waiting.discard(name)
            register_types(name)
    if waiting:
        sys.meta_path.insert(0, _Hook(waiting))


def register_types(lerobot_module: str) -> None:
    """Register the types of one registry, whose module `lerobot_module` is loaded.

    Raises:
        ConfigError: another distribution has put its own files over ours.
    """
    warn_if_newer()
    if not _registering:  # once, before the first of our types
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
    """Return the class decorator that enters a config class of ours into a registry of LeRobot.

    Args:
        registry: LeRobot's base class of such configs.
        name: the type. When another plugin has taken it, the class gets the spare name.
        spare: another name for the same class, None without one.
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


class _Hook(importlib.abc.MetaPathFinder):
    """Registers our types after each of LeRobot's registry modules, and removes itself after the last."""

    def __init__(self, waiting: set[str]):
        self._waiting = waiting

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname not in self._waiting:
            return None
        self._waiting.discard(fullname)
        if not self._waiting:
            sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)  # by the other finders
        if spec is not None and spec.loader is not None:
            spec.loader = _ThenRegister(spec.loader)
        return spec


class _ThenRegister(importlib.abc.Loader):
    """Loads a module by its own loader, then registers our types with it."""

    def __init__(self, loader: importlib.abc.Loader):
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        register_types(module.__name__)
