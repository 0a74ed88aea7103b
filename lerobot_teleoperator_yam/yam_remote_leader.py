"""Leader arms of another computer as a LeRobot teleoperator, like local ones."""

from lerobot_robot_yam.face.devices.remote_device import RemoteDevice
from lerobot_teleoperator_yam.config_yam_remote_leader import BiYamRemoteLeaderConfig, YamRemoteLeaderConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader, YamLeader


class YamRemoteLeader(RemoteDevice, YamLeader):
    """One YAM arm, moved by hand, that another computer drives."""

    config_class = YamRemoteLeaderConfig


class BiYamRemoteLeader(RemoteDevice, BiYamLeader):
    """Two YAM arms, moved by hand, that another computer drives."""

    config_class = BiYamRemoteLeaderConfig
