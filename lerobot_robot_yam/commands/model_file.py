"""Write a model of an arm with its end effector, for other software.

yam-model --format mjcf yam.xml                       for MuJoCo: a yam arm with the linear_4310 gripper
yam-model --format urdf yam.urdf                      for everything else, such as LeRobot's kinematics
yam-model --format urdf --arm yam_pro --gripper crank_4310

Without a file, the model goes to standard output. Exit status: 0 written; 1 it cannot be done; 2 wrong arguments.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import say
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path, write_whole

FORMATS = ("mjcf", "urdf")


def write(path: Path | None, arm: str, gripper: str, form: str) -> int:
    """Write the model to a file, or to standard output if `path` is None; return the exit status.

    Raises:
        ConfigError: no profile is called `arm` or `gripper`, or the file cannot be written.
    """
    from lerobot_robot_yam.arm.export.model_export import mjcf, urdf
    from lerobot_robot_yam.arm.mounting import resolve_profiles

    text = {"mjcf": mjcf, "urdf": urdf}[form](*resolve_profiles(arm, gripper))
    if path is None:
        sys.stdout.write(text)
        return 0
    try:
        write_whole(path, text)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from error
    say(f"{path}: {arm} with {gripper}")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-model`; return its exit status."""
    parser = command_parser("yam-model", __doc__)
    parser.add_argument("path", type=user_path, nargs="?", metavar="FILE", help="file to write")
    parser.add_argument("--format", choices=FORMATS, required=True, help="of the file")
    parser.add_argument("--arm", default="yam", help="profile of the arm, by name or file (default: yam)")
    parser.add_argument("--gripper", default="linear_4310", help="its end effector (default: linear_4310)")
    args = parser.parse_args(arguments)
    return run_command("yam-model", lambda: write(args.path, args.arm, args.gripper, args.format))


if __name__ == "__main__":
    sys.exit(main())
