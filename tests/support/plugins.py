"""Distributions of other projects, small but real: a package, its metadata, the list of its files."""

import textwrap
from pathlib import Path

THEIR_TYPES = """
    from dataclasses import dataclass
    from lerobot.robots.config import RobotConfig
    from lerobot.teleoperators.config import TeleoperatorConfig

    @RobotConfig.register_subclass("yam_follower")
    @dataclass
    class TheirFollowerConfig(RobotConfig):
        serial_port: str = ""

    @TeleoperatorConfig.register_subclass("bi_yam_leader")
    @dataclass
    class TheirLeaderConfig(TeleoperatorConfig):
        serial_port: str = ""
"""


def write_metadata(directory: Path, name: str, version: str, files: list[str] | None = None) -> None:
    """What an installer writes beside the files of a distribution."""
    info = directory / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "RECORD").write_text("".join(f"{file},,\n" for file in files or []))


def write_plugin(directory: Path, name: str, version: str, package: str, files: dict[str, str]) -> None:
    """Install a distribution: the files, by name, of its only package."""
    write_metadata(directory, name, version, [f"{package}/{file}" for file in files])
    for file, text in files.items():
        path = directory / package / file
        path.parent.mkdir(exist_ok=True)
        path.unlink(missing_ok=True)
        path.write_text(textwrap.dedent(text))
