"""Write the URDF of an arm with its end effector, for software that reads nothing else.

yam-urdf yam.urdf                                     an arm yam with the gripper linear_4310
yam-urdf pro.urdf --arm yam_pro --gripper crank_4310

LeRobot's RL stack reads it (docs/hil-serl.md). Exit status: 0 written; 1 it cannot be done; 2 wrong arguments.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.commands.lib.arm_command import run_command
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path


def write(path: Path, arm: str, gripper: str) -> int:
    """Write the file; returns the exit status.

    Raises:
        ConfigError: no such arm or gripper, or the file cannot be written.
    """
    from lerobot_robot_yam.arm.mounting import resolve_profiles
    from lerobot_robot_yam.arm.urdf_export import urdf

    text = urdf(*resolve_profiles(arm, gripper))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from error
    sys.stdout.write(f"{path}: {arm} with {gripper}\n")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `yam-urdf`; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="yam-urdf", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("path", type=user_path, help="file to write")
    parser.add_argument("--arm", default="yam", help="profile of the arm, by name or file (default: yam)")
    parser.add_argument("--gripper", default="linear_4310", help="its end effector (default: linear_4310)")
    args = parser.parse_args(arguments)
    return run_command("yam-urdf", lambda: write(args.path, args.arm, args.gripper))


if __name__ == "__main__":
    sys.exit(main())
