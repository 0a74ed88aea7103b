"""The live part of the page: every arm that runs on this computer, as its state block tells it. It drives nothing."""

import numpy as np
import viser

from lerobot_robot_yam.arm.model import base_quat
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.viewer.live.arm_panel import ArmPanel, warnings
from lerobot_robot_yam.viewer.live.figure import Figure
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm, WatchedArms

_DRAWN_S = 0.05
_APART_M = 0.6  # of arms whose configs do not say where they stand
_GHOST_RAD = 0.005  # a set-point that is nearer than this is not drawn


class _Shown:
    """One arm on the page."""

    def __init__(self, server: viser.ViserServer, arm: WatchedArm):
        self.arm = arm
        self.panel = ArmPanel(server.gui, arm)
        self._figure = self._ghost = None
        self._drawn: tuple[float, ...] = ()
        self.place: tuple[np.ndarray, np.ndarray] | None = None
        if arm.hardware is not None:
            self._figure = Figure(server.scene, f"/arms/{arm.key}", arm.hardware)
            self._ghost = Figure(server.scene, f"/setpoints/{arm.key}", arm.hardware, ghost=True)
            self._ghost.visible = False

    def stand(self, place: int) -> None:
        """Put it where its config says, else beside the others."""
        if self._figure is None or self._ghost is None or self.arm.hardware is None:
            return
        self.place = position, quat = base_of(self.arm.hardware, place)
        self._figure.stand(position, quat)
        self._ghost.stand(position, quat)

    def draw(self) -> None:
        """Pose it as it was measured last."""
        state = self.arm.state
        if self._figure is None or self._ghost is None or state is None:
            return
        now = (*state.positions, *state.setpoints)
        if now == self._drawn:
            return
        self._drawn = now
        self._figure.pose(state.q, state.gripper)
        gap = np.abs(np.nan_to_num(np.subtract(state.setpoint_q, state.q)))
        self._ghost.visible = bool(gap.max(initial=0.0) > _GHOST_RAD)
        if self._ghost.visible:
            self._ghost.pose(state.setpoint_q, state.gripper_setpoint)

    def close(self) -> None:
        self.panel.close()
        for figure in (self._figure, self._ghost):
            if figure is not None:
                figure.remove()


class Live:
    """Shows the arms, says what is wrong with them, and has the emergency stop.

    Args:
        server: viser's.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self._watched = WatchedArms()
        self._shown: dict[str, _Shown] = {}
        self._stop = EmergencyStop()
        server.scene.add_grid("/floor", width=3.0, height=3.0, cell_size=0.1, section_size=0.5)
        self._banner = server.gui.add_html("")
        self._button = server.gui.add_button("EMERGENCY STOP", color="red", icon=viser.Icon.HAND_STOP)
        self._release = server.gui.add_button("release the emergency stop …", visible=False)
        self._button.on_click(lambda _: self._stop.latch("yam-view"))
        self._release.on_click(self._ask_release)

    @property
    def arms(self) -> dict[str, WatchedArm]:
        """The arms that run, by key."""
        return self._watched.arms

    def place_of(self, key: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Where the base of the arm with this key is drawn: position (3,) m, w x y z (4,); None: it is not."""
        shown = self._shown.get(key)
        return None if shown is None else shown.place

    def update(self, now_s: float) -> None:
        """Read, and draw what has changed."""
        self._watched.update(now_s)
        arms = self._watched.arms
        for key in [key for key, shown in self._shown.items() if shown.arm is not arms.get(key)]:
            self._shown.pop(key).close()
        for key, arm in arms.items():
            if key not in self._shown:
                self._shown[key] = _Shown(self._server, arm)
                for place, name in enumerate(sorted(self._shown)):
                    self._shown[name].stand(place)
        for shown in self._shown.values():
            shown.draw()
            shown.panel.update(now_s)
        self._warn()

    def _warn(self) -> None:
        latched = self._stop.latched
        lines = [f"EMERGENCY STOP: {self._stop.reason()}"] if latched else []
        lines += [f"{arm.name}: {line}" for arm in self._watched.arms.values() for line in warnings(arm)]
        text = "<br>".join(lines) or ("no arm runs on this computer" if not self._watched.arms else "")
        colour = "#c00" if lines else "#888"
        content = (
            f"<div style='background:{colour};color:#fff;padding:0.6em;font-weight:bold'>{text}</div>" if text else ""
        )
        if self._banner.content != content:
            self._banner.content = content
        if self._release.visible != latched:
            self._release.visible = latched

    def _ask_release(self, event: viser.GuiEvent) -> None:
        if event.client is None:
            return
        with event.client.gui.add_modal("Release the emergency stop?") as question:
            event.client.gui.add_markdown("Arms go on from where they are, with their next target. Look at them first.")
            yes = event.client.gui.add_button("release", color="red")
            no = event.client.gui.add_button("keep it")

        def release(_: viser.GuiEvent) -> None:
            self._stop.release()
            question.close()

        yes.on_click(release)
        no.on_click(lambda _: question.close())

    def close(self) -> None:
        """Let go of the sessions. Idempotent."""
        self._watched.close()


def base_of(hardware: ResolvedArm, place: int) -> tuple[np.ndarray, np.ndarray]:
    """Where an arm stands in the scene: as its workspace says, else in a row. Position (3,) m, w x y z (4,)."""
    workspace = hardware.config.workspace
    position = np.array(workspace.base_position_m, dtype=float)
    if not position.any():
        position[1] = -_APART_M * place
    return position, base_quat(workspace.base_yaw_rad, hardware.tilt_rad)
