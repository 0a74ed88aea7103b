"""Arms that follow the boxes which a person drags in a desktop window, while control is on."""

from collections.abc import Sequence

from lerobot_robot_yam.arm.kinematics import PoseTracker, YamKinematics
from lerobot_robot_yam.errors import LifeCycleError, YamError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import ArmState
from lerobot_robot_yam.viewer.desktop.desktop_scene import DesktopScene

_REACH_RAD = 0.7  # no joint turns farther for one pose: the arm never swings round to its other side
_ATTEMPTS = 4
_DRIVEN = (Mode.HOLD, Mode.TRACK)


class DragControl:
    """Watches until it is told to control, and then gives the arms the poses of their boxes.

    The control loop keeps its own limits, workspace and collisions, and holds if this goes silent.

    Args:
        session: under way; its arms hold.
        names: of the followers in it that are driven.

    Attributes:
        on: whether the arms follow the boxes.
        said: why it went off by itself; empty: it did not.
    """

    def __init__(self, session: ArmSession, names: Sequence[str]):
        self._clients: dict[str, ArmClient] = {session.key(name): session[name] for name in names}
        self._kinematics = {
            key: YamKinematics(client.hardware.arm, client.hardware.gripper) for key, client in self._clients.items()
        }
        self._trackers = {key: PoseTracker(own, own.middle) for key, own in self._kinematics.items()}
        self.on = False
        self.said = ""

    @property
    def keys(self) -> list[str]:
        """Of the channels of the arms that are driven."""
        return list(self._clients)

    def toggle(self) -> None:
        """Control, or watch again."""
        if self.on:
            self.watch()
            return
        try:
            for key, client in self._clients.items():
                self._trackers[key].restart(self._ready(client).setpoint_q)
            self.on, self.said = True, ""
        except YamError as error:
            self.said = str(error)

    def watch(self, why: str = "") -> None:
        """Drive no more: the arms hold."""
        self.said = why
        for client in self._clients.values() if self.on else ():
            try:
                if client.mode() in _DRIVEN:
                    client.hold()
            except YamError as error:
                self.said = str(error)
        self.on = False

    def update(self, scene: DesktopScene) -> None:
        """Give every arm its next target; while watching, keep its box where its set-point has the tool."""
        try:
            for key, client in self._clients.items():
                if not self.on:
                    scene.put_grip(key, self._kinematics[key].fk(client.observe().setpoint_q))
                    continue
                self._ready(client)
                found = self._trackers[key].solve(scene.grip(key), attempts=_ATTEMPTS, within_rad=_REACH_RAD)
                client.write_target(found.q)
        except YamError as error:
            self.watch(str(error))

    def _ready(self, client: ArmClient) -> ArmState:
        """The state of an arm that takes targets. Raises YamError: it does not."""
        state = client.observe()
        if state.mode not in _DRIVEN:
            raise LifeCycleError(f"{client.config.name} is in {state.mode.name}: it takes no targets")
        return state
