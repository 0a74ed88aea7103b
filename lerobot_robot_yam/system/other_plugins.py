"""Conflicts with other plugins: which distribution owns a module, and whether its files overwrite this package.

PyPI has a `lerobot_robot_yam` from another project, with some files of the same names.
"""

import contextlib
import importlib
import importlib.metadata
import importlib.util

_US = "lerobot_robot_yam"
_OURS_ALONE = f"{_US}/face/registration.py"  # file that only this distribution has


def distribution_of(module: str) -> str:
    """Return name and version of the distribution that owns a module, and the module's name, for messages."""
    package = module.partition(".")[0]
    names = importlib.metadata.packages_distributions().get(package) or [package]
    found = []
    for name in sorted(set(names)):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found.append(f"{name} {importlib.metadata.version(name)}")
    return f"{' / '.join(found) or 'an unknown distribution'} (module {module})"


def overwritten() -> bool:
    """Return whether Python imports another project's `lerobot_robot_yam`, although files of this package exist."""
    return not hasattr(importlib.import_module(_US), "registration")  # set by this package's __init__


def is_foreign(module: str) -> bool:
    """Return whether a module of this package that fails to import is missing, or overwritten by another project."""
    return importlib.util.find_spec(module) is None or bool(_claimants(module.partition(".")[0]))


def mixture(module: str = _US) -> tuple[str, str]:
    """Describe fault and remedy for a module of this package that is missing or overwritten by another project."""
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
    """Return name and version of all other distributions that have installed a package with this name."""
    found = set()
    for distribution in importlib.metadata.distributions():
        files = {str(file) for file in distribution.files or ()}
        if f"{package}/__init__.py" in files and _OURS_ALONE not in files:
            found.add((distribution.metadata["Name"], distribution.version))
    return sorted(found)
