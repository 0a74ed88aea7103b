"""Our types in LeRobot's registries, without importing LeRobot for those who do not use it.

`lerobot.robots.config` alone costs seconds and loads torch, and our own processes (control loop, virtual rig) import
this package too. So each config module of ours is imported right after the LeRobot module that holds its registry:
now, if that is loaded already, else by an import hook at the moment it is. Every LeRobot command loads those it needs.
"""

import importlib
import importlib.abc
import importlib.metadata
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from lerobot_robot_yam.errors import ConfigError

# LeRobot's module: its registry, and for each type the module of ours that registers it.
REGISTRIES: dict[str, tuple[str, dict[str, str]]] = {
    "lerobot.robots.config": (
        "RobotConfig",
        {
            "yam_follower": "lerobot_robot_yam.config_yam_follower",
            "bi_yam_follower": "lerobot_robot_yam.config_bi_yam_follower",
        },
    ),
    "lerobot.teleoperators.config": (
        "TeleoperatorConfig",
        {
            "yam_leader": "lerobot_teleoperator_yam.config_yam_leader",
            "bi_yam_leader": "lerobot_teleoperator_yam.config_bi_yam_leader",
        },
    ),
    "lerobot.envs.configs": ("EnvConfig", {"yam": "lerobot_robot_yam.config_yam_env"}),
    "lerobot.cameras.configs": ("CameraConfig", {"yam_sim": "lerobot_robot_yam.config_yam_camera"}),
    "lerobot.configs.policies": (
        "PreTrainedConfig",
        {"yam_openpi": "lerobot_robot_yam.openpi.configuration_openpi"},
    ),
}


def register() -> None:
    """Register our types with the LeRobot that is loaded, and with what of it is loaded later.

    Raises:
        ConfigError: another distribution has taken the name of one of our types.
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
    """Register the types that belong into the registry of `lerobot_module`, which is loaded.

    Raises:
        ConfigError: another distribution has taken the name of one of our types.
    """
    registry_name, types = REGISTRIES[lerobot_module]
    registry: Any = getattr(sys.modules[lerobot_module], registry_name)
    for type_name, module in types.items():
        holder = registry.get_known_choices().get(type_name)
        if holder is not None and holder.__module__ != module:
            raise ConfigError(
                f"the LeRobot type {type_name!r} of lerobot_robot_yam is already taken by {holder.__module__} of "
                f"{_distribution(holder.__module__)}; uninstall one of the two packages"
            )
        importlib.import_module(module)


def _distribution(module: str) -> str:
    names = importlib.metadata.packages_distributions().get(module.partition(".")[0])
    return "distribution " + " / ".join(sorted(set(names))) if names else "an unknown distribution"


def _is_initialising(module: ModuleType) -> bool:
    return bool(getattr(getattr(module, "__spec__", None), "_initializing", False))


class _Hook(importlib.abc.MetaPathFinder):
    """Watches for LeRobot's registry modules; leaves when it has seen them all."""

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
        for finder in list(sys.meta_path):
            spec = None if finder is self else finder.find_spec(fullname, path, target)
            if spec is not None:
                if spec.loader is not None:
                    spec.loader = _ThenRegister(spec.loader)
                return spec
        return None


class _ThenRegister(importlib.abc.Loader):
    """Loads a module as its own loader would, then registers our types with it."""

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
