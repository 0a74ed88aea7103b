"""The check of a leader's option `follower`, before the leader is energised: whether that arm can be led from here."""

from collections.abc import Collection, Sequence
from pathlib import Path

from lerobot_robot_yam.arm.config import SOCKETCAN, ArmConfig, lead_of
from lerobot_robot_yam.errors import ChannelInUseError, ConfigError
from lerobot_robot_yam.face.devices.command_options import channels_of
from lerobot_robot_yam.state.records import channel_key
from lerobot_robot_yam.system.runtime_files import runtime_dir, sessions

_INTERFACES = Path("/sys/class/net")


def check_followers(leaders: Sequence[ArmConfig], driven: Collection[str]) -> None:
    """Refuse followers that this process cannot lead.

    Args:
        leaders: of the leaders' arms.
        driven: keys of the channels whose arms this process drives.

    Raises:
        ConfigError: the command's robot has other channels; or there is no such CAN interface.
        ChannelInUseError: another process drives it.
    """
    robot = channels_of("robot")
    holders = sessions(runtime_dir())
    for config in leaders:
        lead = lead_of(config)
        if lead is None:
            continue
        key = channel_key(config.interface, lead.follower, config.can_options.get("rig"))
        if key in driven:
            continue
        if robot and lead.follower not in robot.values():
            raise ConfigError(
                f"{config.name}: its follower {lead.follower} is no arm of this command's robot, which has "
                f"{', '.join(robot.values())}; set follower to one of these"
            )
        if key in holders:
            raise ChannelInUseError(
                f"{config.name}: its follower {lead.follower} is driven by process {holders[key]} (ps -p "
                f"{holders[key]}), which takes no targets from here; end it first"
            )
        if config.interface == SOCKETCAN and not (_INTERFACES / lead.follower).exists():
            raise ConfigError(
                f"{config.name}: its follower's channel {lead.follower} is no CAN interface of this computer "
                "(yam-setup-can --list shows them); is the adapter plugged in?"
            )
