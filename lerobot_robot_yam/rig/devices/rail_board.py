"""The rig's board for a rail: two switches and a brake, on a channel of its own beside the base's.

A request says what the brake shall do; the report that answers it has the levels of the switches and the brake's
output. Without requests for a while nothing changes, like with a real output.
"""

from lerobot_robot_yam.damiao.handle_encoder import REPORT_ID
from lerobot_robot_yam.rig.devices.packets import Frame
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.scene.scene import RailPlacement
from lerobot_robot_yam.rig.world.world import World

SWITCHES = ("upper", "lower")
_CLOSING_S, _OPENING_S = 0.02, 0.04  # time until the brake grips or lets go, s; our choice, usual for such brakes


class SimRailBoard(SimHandle):
    """Board of one rail. In place of a handle: it answers the requests of its channel.

    Attributes:
        brake_on: whether the brake's output engages it; it grips a little later.
        stuck: switch → what it reads instead of the truth. An unplugged one reads True.
        slips: whether the brake does not grip.
    """

    def __init__(self, world: World, base: str, row: RailPlacement):
        super().__init__()
        joint = world.model.joint(f"{base}/rail")
        self._world, self._row = world, row
        self._q, self._brake = int(joint.qposadr[0]), int(world.model.equality(f"{base}/brake").id)
        self.brake_on, self._changed_s = True, -1.0
        self.stuck: dict[str, bool] = {}
        self.slips, self._closed = False, True
        self._grip()

    @property
    def height_m(self) -> float:
        """True height of the carriage, m."""
        return self._world.qpos[self._q]

    def switches(self) -> tuple[bool, bool]:
        """Return what upper and lower switch read."""
        true = {"upper": self.height_m >= self._row.stroke_m, "lower": self.height_m <= 0.0}
        upper, lower = (self.stuck.get(name, true[name]) for name in SWITCHES)
        return upper, lower

    def requests(self, data: bytes) -> list[Frame]:
        if self.silent or not data:
            return []
        if bool(data[0]) != self.brake_on:
            self.brake_on, self._changed_s = bool(data[0]), self._world.sim_s
        return [Frame(0.0, REPORT_ID, bytes((*self.switches(), self.brake_on)))]

    def due_reports(self, now_s: float) -> list[Frame]:
        """Let the brake grip or let go; it is called every few ms. Returns no reports."""
        self._grip()
        return []

    def _grip(self) -> None:
        since_s = self._world.sim_s - self._changed_s
        self._closed = self._closed or since_s >= _CLOSING_S if self.brake_on else self._closed and since_s < _OPENING_S
        grips = self._closed and not self.slips
        if grips and not self._world.data.eq_active[self._brake]:
            self._world.model.eq_data[self._brake, 0] = self.height_m
        self._world.data.eq_active[self._brake] = grips
