"""The emergency stops of workstations on the host: latched here while they are latched there.

Programs of the host's own user and runtime directory share its latch: to mirror that would keep it latched for ever.
"""

from dataclasses import dataclass

from lerobot_robot_yam.remote.wire.host_address import machine_number
from lerobot_robot_yam.remote.wire.mirrored_stop import MirroredStop
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

_GONE_S = 2.0  # without a beat: what is latched stays so, but is not latched anew when somebody releases it here
_MOST = 64  # machines that are remembered
_WHY = "its emergency stop is latched; release it there"


@dataclass
class _Machine:
    mirror: MirroredStop
    stopped: bool
    heard_s: float


class ClientStops:
    """Of all machines whose programs have said something.

    Attributes:
        stopped: whether the emergency stop is latched here, and the machine because of which.
    """

    def __init__(self) -> None:
        self._stop = EmergencyStop()
        self._machines: dict[int, _Machine] = {}
        self._own = machine_number()
        self.stopped = (False, self._own)

    def hear(self, number: int, stopped: bool, now: float) -> None:
        """A beat of a machine says whether it is latched there. When it no longer is, what that has latched ends."""
        if number == self._own:
            return
        machine = self._machines.get(number)
        if machine is None:
            if len(self._machines) >= _MOST:
                self._machines.pop(min(self._machines, key=lambda other: self._machines[other].heard_s))
            machine = self._machines[number] = _Machine(MirroredStop(f"workstation {number:x}"), not stopped, now)
        machine.heard_s = now
        if machine.stopped is not stopped:
            machine.stopped = stopped
            machine.mirror.follow(stopped, _WHY)
            self.look(now)

    def look(self, now: float) -> None:
        """Latch again what is latched on a machine that is there, and note how things are."""
        if not self._stop.latched:
            for machine in self._machines.values():
                if machine.stopped and now - machine.heard_s < _GONE_S:
                    machine.mirror.follow(True, _WHY)
                    break
        by = self._own
        if latched := self._stop.latched:
            by = next((number for number, machine in self._machines.items() if machine.mirror.taken_over), by)
        self.stopped = (latched, by)
