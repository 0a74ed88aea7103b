"""The emergency stops of workstations on the host: latched here while they are latched there.

A machine's programs have a link each, and look at its latch at different times: it is latched there while one of them
says so. Programs of the host's own user and runtime directory share its latch: to mirror that would keep it latched for
ever.
"""

from dataclasses import dataclass, field

from lerobot_robot_yam.remote.wire.host_address import machine_number
from lerobot_robot_yam.remote.wire.mirrored_stop import MirroredStop
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

_GONE_S = 2.0  # without a beat: what is latched stays so, but is not latched anew when somebody releases it here
_MOST = 64  # machines that are remembered
_WHY = "its emergency stop is latched; release it there"


@dataclass
class _Machine:
    mirror: MirroredStop
    heard_s: float
    stopped: bool = False
    links: dict[bytes, tuple[bool, float]] = field(default_factory=dict)  # what each has said last, and when


class ClientStops:
    """Of all machines whose programs have said something.

    Attributes:
        stopped: whether the emergency stop is latched here, and the machine because of which.
        unwritten: a machine's stop cannot be latched here.
    """

    def __init__(self) -> None:
        self._stop = EmergencyStop()
        self._machines: dict[int, _Machine] = {}
        self._own = machine_number()
        self.stopped, self.unwritten = (False, self._own), False

    def hear(self, number: int, link: bytes, stopped: bool, now: float) -> None:
        """A beat says whether it is latched on a machine. When no link says so any more, what it has latched ends.

        Args:
            number: of the machine.
            link: of its program, on which the beat has come.
            stopped: what it says.
            now: s.
        """
        if number == self._own:
            return
        machine = self._machines.get(number)
        if machine is None:
            if len(self._machines) >= _MOST:
                self._machines.pop(min(self._machines, key=lambda other: self._machines[other].heard_s))
            machine = self._machines[number] = _Machine(MirroredStop(f"workstation {number:x}"), now)
        machine.heard_s, machine.links[link] = now, (stopped, now)
        machine.links = {link: said for link, said in machine.links.items() if now - said[1] < _GONE_S}
        before, machine.stopped = machine.stopped, any(said for said, _ in machine.links.values())
        if machine.stopped is not before:
            self.look(now)

    def look(self, now: float) -> None:
        """Have the latch here as machines say, and note how things are.

        What is latched on a machine that is there, and was released here, is latched again.
        """
        machines = self._machines
        for machine in sorted(machines.values(), key=lambda machine: machine.stopped):  # who lets go comes first
            if not machine.stopped or machine.mirror.unwritten or now - machine.heard_s < _GONE_S:
                machine.mirror.follow(machine.stopped, _WHY)
        self.unwritten = any(machine.mirror.unwritten for machine in machines.values())
        by = self._own
        if latched := self.unwritten or self._stop.latched:
            mirrors = ((number, machine.mirror) for number, machine in machines.items())
            by = next((number for number, mirror in mirrors if mirror.unwritten or mirror.taken_over), by)
        self.stopped = (latched, by)
