"""Where a data set is: a directory, or the name that LeRobot stores it under, here or on the Hub."""

from pathlib import Path

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path


def locate(path_or_repo_id: str) -> Path:
    """The directory of a data set; one that is not on this computer is downloaded by LeRobot.

    Raises:
        ConfigError: there is no such data set, or it cannot be downloaded.
    """
    path = user_path(path_or_repo_id)
    if path.is_dir():
        return path
    from lerobot.utils.constants import HF_LEROBOT_HOME

    stored = HF_LEROBOT_HOME / path_or_repo_id
    if (stored / "meta").is_dir():
        return stored
    from lerobot.datasets import LeRobotDataset  # seconds to import

    try:
        return Path(LeRobotDataset(path_or_repo_id).root)
    except Exception as error:  # no such name, no network: LeRobot and the Hub raise anything
        raise ConfigError(
            f"{path_or_repo_id} is no directory, no data set in {HF_LEROBOT_HOME}, and cannot be had from the Hub: "
            f"{type(error).__name__}: {str(error).partition(chr(10))[0][:200]}"
        ) from error
