"""The part of the page that drives arms: nothing is energised before a person has confirmed it there."""

import functools
from collections.abc import Callable

import viser

from lerobot_robot_yam.arm.config import VIRTUAL
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.rig.lockstep.lockstep_rig import find_lockstep
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.viewer.live.placement import Place
from lerobot_robot_yam.viewer.moving.control_panel import ControlPanel
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.moving.driving_plan import DrivingPlan
from lerobot_robot_yam.viewer.moving.joint_sliders import JointSliders
from lerobot_robot_yam.viewer.moving.rig_panel import RigPanel
from lerobot_robot_yam.viewer.moving.saved_poses import PosePanel, SavedPoses
from lerobot_robot_yam.viewer.moving.tool_handle import ToolHandle

_NOTICE_S = 8.0


class Moving:
    """Controls for the arms of a plan.

    Args:
        server: viser's.
        plan: the arms.
        place: where the page draws the base of the arm with this channel key; None: it does not, yet.
        isolation: see `ArmSession`.

    Attributes:
        driver: what drives them. Its thread has to be started.

    Raises:
        ConfigError: the arms cannot be used together, or their file of saved poses cannot be read.
        RigError: the virtual rig cannot be started.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        plan: DrivingPlan,
        place: Callable[[str], Place | None],
        isolation: Isolation = "process",
    ):
        self._server = server
        self.driver = driver = Driver(plan, server, isolation)
        session, gui = driver.session, server.gui
        hardware = [session.hardware(config.name) for config in plan.configs]
        self._rig: RigOperations | None = None
        try:
            poses = SavedPoses(plan.poses, hardware)
            with gui.add_folder("move") as folder:
                self._control = ControlPanel(server, driver)
                self._sliders = [JointSliders(gui, driver, arm) for arm in hardware]
                PosePanel(gui, driver, poses)
                self._rig = _rig_of(driver)
                if self._rig is not None:
                    RigPanel(gui, driver, self._rig, [config.channel for config in plan.configs])
            self._tools = [
                ToolHandle(server.scene, driver, arm, functools.partial(place, session.key(arm.name)))
                for arm in hardware
                if arm.joints
            ]
        except BaseException:
            self.close()
            raise

        @server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            with folder:
                client.gui.add_markdown(f"This is browser {client.client_id}.", order=0.0)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            driver.ask_to_leave(client.client_id)

    def update(self, now_s: float) -> None:
        """Show where the arms are, and what is to be said."""
        self._control.update()
        for sliders in self._sliders:
            sliders.update()
        for tool in self._tools:
            tool.update()
        clients = self._server.get_clients()
        while self.driver.notices:
            notice = self.driver.notices.popleft()
            for browser, client in clients.items():
                if notice.browser in (None, browser):
                    client.add_notification("arms", notice.text, auto_close_seconds=_NOTICE_S)

    def close(self) -> None:
        """Land the arms. Idempotent."""
        self.driver.close()
        if isinstance(self._rig, RigControl):
            self._rig.close()


def _rig_of(driver: Driver) -> RigOperations | None:
    """The virtual rig that the arms are on; None: they are real."""
    for config in driver.plan.configs:
        options = dict(driver.session.hardware(config.name).config.can_options)
        rig = options.pop("rig", None)
        if config.interface == VIRTUAL:
            return RigControl(rig, options.pop("scene", None), **options)
        if lockstep := find_lockstep(rig):
            return lockstep
    return None
