"""Follower arms of another computer as a LeRobot robot; data sets call them by the names of local arms."""

from lerobot_robot_yam.config_yam_remote import BiYamRemoteConfig, YamRemoteConfig
from lerobot_robot_yam.face.devices.remote_device import RemoteDevice
from lerobot_robot_yam.yam_follower import BiYamFollower, YamFollower


class YamRemote(RemoteDevice, YamFollower):
    """One YAM arm that another computer drives."""

    config_class = YamRemoteConfig


class BiYamRemote(RemoteDevice, BiYamFollower):
    """Two YAM arms that another computer drives."""

    config_class = BiYamRemoteConfig
