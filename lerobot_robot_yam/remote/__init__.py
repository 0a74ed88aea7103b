"""Arms on another computer: the host that drives them, and the link to the host (docs/two-machines.md)."""

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

try:
    import msgspec  # noqa: F401
    import zmq  # noqa: F401
except ImportError as error:
    raise ConfigError(f"arms on another computer need more ({error}); {install_extra('remote')}") from error
