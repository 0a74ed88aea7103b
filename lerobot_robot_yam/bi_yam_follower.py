"""Two follower arms as one LeRobot robot."""

from lerobot_robot_yam.config_bi_yam_follower import BiYamFollowerConfig
from lerobot_robot_yam.yam_follower import FollowerBase


class BiYamFollower(FollowerBase):
    """Two YAM arms that follow LeRobot's actions; one control loop drives both in step."""

    config_class = BiYamFollowerConfig
    name = "bi_yam_follower"

    def __init__(self, config: BiYamFollowerConfig):
        super().__init__(config, config.arms(), config.all_cameras())


BiI2rtYamFollower = BiYamFollower  # LeRobot looks for the device of a config by this name
