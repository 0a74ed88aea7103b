"""The drivers of the rail's switches and brake, by the names that a configuration gives them."""

import importlib
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.system.own_commands import install_extra

_DRIVERS = {
    "gpio": f"{__package__}.gpio_io",
    "usb_gpio": f"{__package__}.usb_gpio_io",
    "sim": "lerobot_robot_yam.rig.client.rail_board_io",
}


def load_driver(hardware: ResolvedBase) -> Any:
    """Return the module of the driver; `open_driver` of it opens one. The first import takes time.

    Raises:
        ConfigError: a package is missing.
    """
    assert hardware.config.rail is not None
    name = hardware.config.rail.io
    try:
        return importlib.import_module(_DRIVERS[name])
    except ImportError as error:
        raise ConfigError(f"{hardware.name}: rail: io {name} needs {error.name}: {install_extra('rail')}") from error
