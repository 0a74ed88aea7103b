"""Teleoperators of somebody else, as LeRobot finds them: `--teleop.discover_packages_path=tests.teleop_plugin`.

Those that LeRobot brings need hardware of their own, or speak of other keys than joints.
"""

from tests.teleop_plugin import config_drive as config_drive
from tests.teleop_plugin import config_swing as config_swing
