"""List the packaged LeRobot run configs, print their paths, or copy them for editing.

yam-configs                 lists them with their paths
yam-configs copy my_lab     copies them into the directory my_lab
lerobot-record --config_path="$(yam-configs path sim/record)"
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path


def configs_dir() -> Path:
    """Return the directory of the run configs: in the package, or for an editable install beside the package.

    Raises:
        ConfigError: the installation lacks the run configs.
    """
    package = Path(__file__).parents[1]
    for candidate in (package / "configs", package.parent / "configs"):
        if (candidate / "sim" / "record.yaml").is_file():
            return candidate
    raise ConfigError(f"no run configs beside {package}; install the package again")


def config_path(name: str) -> Path:
    """Return the path of the config called `name`, such as "sim/record".

    Raises:
        ConfigError: no config is called `name`; the message lists the available names.
    """
    path = configs_dir() / f"{name.removesuffix('.yaml')}.yaml"
    if not path.is_file():
        raise ConfigError(f"no config {name!r}; there are: {', '.join(config_names())}")
    return path


def config_names() -> list[str]:
    """Return the names of all packaged configs, such as "sim/record"."""
    root = configs_dir()
    return sorted(str(path.relative_to(root).with_suffix("")) for path in root.glob("*/*.yaml"))


def copy_configs(target: Path) -> list[Path]:
    """Copy all configs into subdirectories of `target`; return the paths of the copies.

    Raises:
        ConfigError: a copy would overwrite an existing file; nothing was copied.
    """
    copies = {config_path(name): target / f"{name}.yaml" for name in config_names()}
    present = [str(path) for path in copies.values() if path.exists()]
    if present:
        raise ConfigError(f"{', '.join(present)} would be overwritten; choose another directory")
    for source, path in copies.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, path)
    return list(copies.values())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-configs`; return its exit status."""
    parser = argparse.ArgumentParser(prog="yam-configs", description="Run configs for LeRobot's commands.")
    actions = parser.add_subparsers(dest="action")
    actions.add_parser("list", help="list the configs with their paths (the default)")
    actions.add_parser("path", help="print the path of one config").add_argument("name", help="such as sim/record")
    actions.add_parser("copy", help="copy all configs").add_argument("directory", type=user_path)
    args = parser.parse_args(arguments)
    try:
        if args.action == "copy":
            lines = [str(path) for path in copy_configs(args.directory)]
        elif args.action == "path":
            lines = [str(config_path(args.name))]
        else:
            lines = [f"{name:24} {config_path(name)}" for name in config_names()]
    except ConfigError as error:
        sys.stderr.write(f"yam-configs: {error}\n")
        return 2
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
