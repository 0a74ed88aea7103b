"""YAM rollout strategies for LeRobot. `lerobot_robot_yam` registers their type; modules are loaded on first use."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lerobot_strategy_yam.config_yam_dagger import YamDaggerStrategyConfig as YamDaggerStrategyConfig
    from lerobot_strategy_yam.yam_dagger import YamDaggerStrategy as YamDaggerStrategy

_MODULES = {"YamDaggerStrategy": "yam_dagger", "YamDaggerStrategyConfig": "config_yam_dagger"}
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(_MODULES)}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
