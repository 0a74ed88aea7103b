"""What a running rig simulates, for others who build the same world: its arguments, in a file beside its socket.

To read it costs the rig nothing, unlike a question.
"""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.client import launch
from lerobot_robot_yam.rig.scene.scene import SCENES, Scene, load_scene
from lerobot_robot_yam.system.paths import user_path


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:  # else it would end the process
        raise ValueError(message)


def scene_path(rig: str) -> Path:
    """The file of the rig of that name."""
    return launch.rig_path(rig, "scene")


def tell_scene(rig: str, scene: str | None, options: Mapping[str, Any]) -> None:
    """Write it."""
    whole = scene if scene is None or scene in SCENES else str(user_path(scene).absolute())
    scene_path(rig).write_text(json.dumps(launch.scene_arguments(whole, options)))


def told_scene(rig: str) -> Scene:
    """The scene of a running rig.

    Raises:
        RigError: no such rig runs, or one of another version.
        ConfigError: its file is no longer what the rig has read.
    """
    parser = _Parser(add_help=False)
    launch.add_scene_arguments(parser)
    try:
        arguments = parser.parse_args(json.loads(scene_path(rig).read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise RigError(f"rig {rig} does not say what it simulates ({error}); start it anew") from error
    return load_scene(arguments.scene, launch.options_of(arguments))
