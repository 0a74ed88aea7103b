"""The mobile base that a robot of this process drives, for teleoperators that need its heading, limits or odometry."""

from lerobot_robot_yam.face.devices.device_session import connected_sessions
from lerobot_robot_yam.session.base_client import BaseClient


def driven_base() -> BaseClient | None:
    """Return the client of the connected base; None if this process drives none."""
    return next((base for session in connected_sessions for base in session.bases), None)
