"""Clashes with other projects' plugins: which distribution owns a module, and whether its files overwrite ours.

The package index has another project's `lerobot_robot_yam`, some of whose files have the same names as ours.
"""

import contextlib
import importlib
import importlib.metadata
import importlib.util

_US = "lerobot_robot_yam"
_OURS_ALONE = f"{_US}/face/registration.py"  # file that no other distribution has


def distribution_of(module: str) -> str:
    """Return name and version of the distribution that a module comes from, and the module, for messages."""
    package = module.partition(".")[0]
    names = importlib.metadata.packages_distributions().get(package) or [package]
    found = []
    for name in sorted(set(names)):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found.append(f"{name} {importlib.metadata.version(name)}")
    return f"{' / '.join(found) or 'an unknown distribution'} (module {module})"


def overwritten() -> bool:
    """Return whether Python imports another project's `lerobot_robot_yam`, although files of ours are there."""
    return not hasattr(importlib.import_module(_US), "registration")  # our __init__ imports it


def is_foreign(module: str) -> bool:
    """Return whether a module of ours that cannot be imported is missing, or overwritten by another project."""
    return importlib.util.find_spec(module) is None or bool(_claimants(module.partition(".")[0]))


def mixture(module: str = _US) -> tuple[str, str]:
    """Describe the fault and its remedy for a module of ours that is missing or another project's."""
    package = module.partition(".")[0]
    others = _claimants(package)
    theirs = " and ".join(f"{name} {version}" for name, version in others) or "another distribution"
    names = " ".join(sorted({_US, *(name for name, _ in others)}))
    what = f"{module} is not the YAM driver's: {theirs} has put its files over ours; such a mixture may drive no arm"
    remedy = (
        f"uninstall both (pip uninstall {names}, until none is left), delete what is left of the directory {package}, "
        "and install the driver again from its clone"
    )
    return what, remedy


def _claimants(package: str) -> list[tuple[str, str]]:
    """Return name and version of other distributions that have installed a package of this name."""
    found = set()
    for distribution in importlib.metadata.distributions():
        files = {str(file) for file in distribution.files or ()}
        if f"{package}/__init__.py" in files and _OURS_ALONE not in files:
            found.add((distribution.metadata["Name"], distribution.version))
    return sorted(found)
