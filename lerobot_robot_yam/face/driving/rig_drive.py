"""The virtual rig's scripted operator as a driver of the base: it says how fast the base shall go."""

import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.face.driving.base_drive import Asked
from lerobot_robot_yam.face.lerobot_command.running_command import Phase, recording
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.rig.lockstep.lockstep_rig import find_lockstep
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from lerobot_robot_yam.system.runtime_files import rig_name


class RigDrive:
    """What a rig's operator asks, see `Driver` and `HandOperations.ask_drive`.

    Args:
        rig: name of the rig, which runs when it is first asked.
        speed: velocity at full deflection, (3,), m/s, m/s, deg/s.
    """

    def __init__(self, rig: str | None, speed: Sequence[float]):
        self._name, _ = rig_name(rig)
        self._rig: RigOperations | None = None
        self._full = np.array([speed[0], speed[1], math.radians(speed[2])])

    def asked(self) -> Asked:
        """Return what the operator asks now."""
        try:
            if self._rig is None:
                self._rig = find_lockstep(self._name) or RigControl(self._name, hold=False)
            velocity = np.array(self._rig.asked_drive(True, _episode())["velocity"])
        except RigError as error:
            return Asked(trouble=str(error))
        x, y, theta = np.clip(velocity / self._full, -1.0, 1.0).tolist()
        return Asked((x, y, theta, 0.0))

    def close(self) -> None:
        """Disconnect from the rig. Idempotent."""
        rig, self._rig = self._rig, None
        if isinstance(rig, RigControl):
            rig.close()


def _episode() -> float | None:
    """Return the number of the episode that is being recorded; 0 without a recording, None between two episodes."""
    now = recording()
    if now is None:
        return 0.0
    return now.turn if now.phase is Phase.RECORDING else None
