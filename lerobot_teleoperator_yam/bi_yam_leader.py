"""Two leader arms as one LeRobot teleoperator."""

from lerobot_teleoperator_yam.config_bi_yam_leader import BiYamLeaderConfig
from lerobot_teleoperator_yam.yam_leader import LeaderBase


class BiYamLeader(LeaderBase):
    """Two YAM arms moved by hand; one control loop drives both in step."""

    config_class = BiYamLeaderConfig
    name = "bi_yam_leader"

    def __init__(self, config: BiYamLeaderConfig):
        super().__init__(config, config.arms())


BiI2rtYamLeader = BiYamLeader  # LeRobot looks for the device of a config by this name
