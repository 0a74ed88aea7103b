"""YAM leader arms, gamepads and keys for LeRobot. `lerobot_robot_yam` registers the types; modules load on use."""

import importlib
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.other_plugins import mixture, overwritten

if TYPE_CHECKING:
    from lerobot_teleoperator_yam.config_yam_gamepad import YamBaseKeysConfig as YamBaseKeysConfig
    from lerobot_teleoperator_yam.config_yam_gamepad import YamGamepadConfig as YamGamepadConfig
    from lerobot_teleoperator_yam.config_yam_hand_guide import BiYamHandGuideConfig as BiYamHandGuideConfig
    from lerobot_teleoperator_yam.config_yam_hand_guide import YamHandGuideConfig as YamHandGuideConfig
    from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig as BiYamLeaderConfig
    from lerobot_teleoperator_yam.config_yam_leader import YamLeaderConfig as YamLeaderConfig
    from lerobot_teleoperator_yam.config_yam_mobile_leader import YamMobileLeaderConfig as YamMobileLeaderConfig
    from lerobot_teleoperator_yam.config_yam_passive_leader import BiYamPassiveLeaderConfig as BiYamPassiveLeaderConfig
    from lerobot_teleoperator_yam.config_yam_passive_leader import YamPassiveLeaderConfig as YamPassiveLeaderConfig
    from lerobot_teleoperator_yam.yam_base_keys import YamBaseKeys as YamBaseKeys
    from lerobot_teleoperator_yam.yam_gamepad import YamGamepad as YamGamepad
    from lerobot_teleoperator_yam.yam_hand_guide import BiYamHandGuide as BiYamHandGuide
    from lerobot_teleoperator_yam.yam_hand_guide import YamHandGuide as YamHandGuide
    from lerobot_teleoperator_yam.yam_leader import BiYamLeader as BiYamLeader
    from lerobot_teleoperator_yam.yam_leader import YamLeader as YamLeader
    from lerobot_teleoperator_yam.yam_mobile_leader import YamMobileLeader as YamMobileLeader
    from lerobot_teleoperator_yam.yam_passive_leader import BiYamPassiveLeader as BiYamPassiveLeader
    from lerobot_teleoperator_yam.yam_passive_leader import YamPassiveLeader as YamPassiveLeader

_MODULES = {
    "YamBaseKeys": "yam_base_keys",
    "YamBaseKeysConfig": "config_yam_gamepad",
    "YamGamepad": "yam_gamepad",
    "YamGamepadConfig": "config_yam_gamepad",
    "YamMobileLeader": "yam_mobile_leader",
    "YamMobileLeaderConfig": "config_yam_mobile_leader",
    "YamPassiveLeader": "yam_passive_leader",
    "YamPassiveLeaderConfig": "config_yam_passive_leader",
    "BiYamPassiveLeader": "yam_passive_leader",
    "BiYamPassiveLeaderConfig": "config_yam_passive_leader",
    "YamHandGuide": "yam_hand_guide",
    "YamHandGuideConfig": "config_yam_hand_guide",
    "BiYamHandGuide": "yam_hand_guide",
    "BiYamHandGuideConfig": "config_yam_hand_guide",
    "YamLeader": "yam_leader",
    "YamLeaderConfig": "config_yam_leader",
    "BiYamLeader": "yam_leader",
    "BiYamLeaderConfig": "config_yam_leader",
}
__all__ = list(_MODULES)

if overwritten():
    raise ConfigError("; ".join(mixture()))


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(_MODULES)}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
