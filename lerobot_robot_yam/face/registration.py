"""Our types in LeRobot's registries, without importing LeRobot where it is not used.

`lerobot.robots.config` alone costs seconds and loads torch, and our own processes (control loop, virtual rig) import
this package too. So each config module of ours is imported right after the LeRobot module that holds its registry:
now, if that is loaded already, else by an import hook at the moment it is. Every LeRobot command loads those it needs.

Other plugins claim some of our names. Each device therefore has a spare name, and a name that is taken costs us that
name only.

The same moment serves for three messages. One says that LeRobot is newer than tested; one that the command's config
file is no YAML (`config_file`). The third shortens LeRobot's page about FFmpeg: torchcodec tries FFmpeg 4 to 8, and
LeRobot logs all attempts before it reads videos with PyAV, which has an FFmpeg with it. Where anything else than
missing libraries was the reason, the page is shown as it is.
"""

import importlib
import importlib.abc
import importlib.metadata
import importlib.util
import logging
import re
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.config_file import refuse_unreadable
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

NEWEST_TESTED = "0.6.2"  # the repository's state of August 2026; 0.6.1 is the package index's newest

_BEGIN, _END = "[start of libtorchcodec loading traceback]", "[end of libtorchcodec loading traceback]"
_ATTEMPT = re.compile(r"^FFmpeg version \d+:\n", re.MULTILINE)
# The innermost exception of an attempt: the system's loader has not found FFmpeg.
_MISSING = re.compile(r"^OSError: lib(?:av|sw)\w+\.so\.\d+: cannot open shared object file: No such file", re.MULTILINE)
_INSTEAD = "FFmpeg's libraries are not installed: LeRobot reads videos with PyAV, which does as well"

logger = logging.getLogger(__name__)
_told_of_newer = False
_registering: set[str] = set()  # modules that have called `register_as`: ours, not somebody else's of the same name


def register() -> None:
    """Register our types with the LeRobot that is loaded, and with what of it is loaded later.

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
    """Register the types that belong into the registry of `lerobot_module`, which is loaded.

    Raises:
        ConfigError: another distribution has put its own files over ours.
    """
    warn_if_newer()
    if not _registering:  # once: before the first of ours
        refuse_unreadable()
    logging.getLogger("lerobot.utils.import_utils").addFilter(_shorten)  # adds it once
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
    """Class decorator: enter a config class of ours into a registry of LeRobot.

    Args:
        registry: LeRobot's base class of such configs.
        name: of the type. When another plugin has taken it, the class gets the spare name.
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
    """Registers our types when one of LeRobot's registry modules has been loaded; leaves when it has seen them all."""

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
        spec = importlib.util.find_spec(fullname)  # as the other finders say
        if spec is not None and spec.loader is not None:
            spec.loader = _ThenRegister(spec.loader)
        return spec


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


def warn_if_newer() -> None:
    """Say so, once in a process, when the installed LeRobot is newer than any that this package is tested with."""
    global _told_of_newer
    if _told_of_newer:
        return
    _told_of_newer = True
    try:
        installed = importlib.metadata.version("lerobot")
    except importlib.metadata.PackageNotFoundError:  # a source tree on the path, which has no version
        return
    if _release(installed) > _release(NEWEST_TESTED):
        logger.warning(
            "LeRobot %s is newer than %s, the newest that the YAM driver is tested with. "
            "If something fails, look for a newer driver, or install that LeRobot",
            installed,
            NEWEST_TESTED,
        )


def _release(version: str) -> tuple[int, ...]:
    """The first three numbers of a version, without what says of which pre-release or build it is."""
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])


class _Shorten(logging.Filter):
    """Lets one line pass the first time, and nothing after that."""

    told = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to show a record; one about FFmpeg's absence is shortened."""
        if not _is_absence(record.getMessage()):
            return True
        record.msg, record.args = _INSTEAD, ()
        told, self.told = self.told, True
        return not told


_shorten = _Shorten()


def _is_absence(message: str) -> bool:
    _, begun, rest = message.partition(_BEGIN)
    attempts = _ATTEMPT.split(rest.partition(_END)[0])[1:]
    return bool(begun and attempts) and all(_MISSING.search(attempt) for attempt in attempts)
