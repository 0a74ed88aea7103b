"""What the strategy refuses, and when: as a LeRobot that cannot run it is concerned, while the config is read."""

import draccus
import pytest
from lerobot.rollout.configs import RolloutStrategyConfig

from lerobot_robot_yam.errors import ConfigError
from lerobot_strategy_yam import YamDaggerStrategy
from lerobot_strategy_yam.config_yam_dagger import TAKES_PLUGINS
from lerobot_strategy_yam.take_over import TakeOverSignals
from lerobot_teleoperator_yam.config_yam_mobile_leader import YamMobileLeaderConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader
from lerobot_teleoperator_yam.yam_mobile_leader import YamMobileLeader
from tests.face.devices.test_lerobot_contract import leader_config
from tests.support.strategy_here import HereConfig


@pytest.mark.skipif(TAKES_PLUGINS, reason="needs a LeRobot without strategies from plugins")
def test_a_lerobot_without_plugins_for_strategies_is_named():
    with pytest.raises(ConfigError, match="needs a LeRobot that takes .* use --strategy.type=dagger"):
        draccus.decode(RolloutStrategyConfig, {"type": "yam_dagger"})


@pytest.mark.skipif(not TAKES_PLUGINS, reason="needs a LeRobot with strategies from plugins")
def test_a_lerobot_with_plugins_for_strategies_makes_it():
    from lerobot.rollout import create_strategy

    config = draccus.decode(RolloutStrategyConfig, {"type": "yam_dagger", "rewind_s": 2.0})
    assert isinstance(create_strategy(config), YamDaggerStrategy)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"rewind_button": "bottom"}, "take_over_button and rewind_button are the same"),
        ({"rewind_s": -1.0}, "rewind_s takes a time within 0"),
        ({"hand_back_s": float("nan")}, "hand_back_s takes a time"),
    ],
)
def test_values_that_cannot_be_are_refused(options, says):
    with pytest.raises(ConfigError, match=says):
        HereConfig(**options)


class Context:
    """Of LeRobot's, the part that is looked at first."""

    def __init__(self, teleop):
        self.hardware = self.runtime = self
        self.teleop, self.cfg = teleop, None


def leading(directory, **options):
    """Two leaders that lead, with these options of the right one's arm."""
    config = leader_config("none", directory)
    for side in ("left", "right"):
        getattr(config, f"{side}_arm_config").follower = f"follower_{side}"
    for name, value in options.items():
        setattr(config.right_arm_config, name, value)
    return config


def test_leaders_that_do_not_lead_and_buttons_with_two_meanings_are_refused(tmp_path):
    alone, pressing = leader_config("none", tmp_path), leading(tmp_path)
    pressing.buttons = "dagger"
    for config, says in [
        (alone, "left leader: set follower"),
        (leading(tmp_path, fine_button="top"), "right_top has two meanings: fine_button, and"),
        (leading(tmp_path, estop_button="bottom"), "right_bottom has two meanings: estop_button"),
        (pressing, "leave the teleoperator's option buttons away"),
    ]:
        with pytest.raises(ConfigError, match=says):
            YamDaggerStrategy(HereConfig()).setup(Context(BiYamLeader(config)))
    with pytest.raises(ConfigError, match="needs YAM leaders"):
        YamDaggerStrategy(HereConfig()).setup(Context(None))
    arms = {side: getattr(leading(tmp_path), side) for side in ("left_arm_config", "right_arm_config")}
    with pytest.raises(ConfigError, match="takes over arms, not the base of .* YamMobileLeader"):
        YamDaggerStrategy(HereConfig()).setup(
            Context(YamMobileLeader(YamMobileLeaderConfig(calibration_dir=tmp_path, **arms)))
        )
    gated = leading(tmp_path, gate="button", gate_button="bottom", gate_together=False)
    assert TakeOverSignals(BiYamLeader(gated), HereConfig()).prefixes == ["left_", "right_"]
