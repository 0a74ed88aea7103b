"""Live part of the page: shows the arms and cameras of this computer while other programs use them. Read-only."""

import html
import json
from collections.abc import Sequence

import numpy as np
import viser
import viser._messages

from lerobot_robot_yam.cameras.video_devices import VideoDevice, holders, video_devices
from lerobot_robot_yam.viewer.figure import Figure, Place, add_workspace
from lerobot_robot_yam.viewer.live.arm_panel import ArmPanel, warnings
from lerobot_robot_yam.viewer.live.bases import Bases
from lerobot_robot_yam.viewer.live.placement import mount_of, places
from lerobot_robot_yam.viewer.live.stop_button import StopButton
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm, WatchedArms
from lerobot_robot_yam.viewer.live.watched_rigs import WatchedRigs

_BEAT_S = 1.0
_SILENT_S = 4.0
_SILENT = "NO WORD FROM yam-view: what this page shows is old. Stop the arms with their own emergency stop."

# `Banner.show` prepends `lines`, `silent` and `silentMs`. The timer in the browser warns when updates cease.
_SHOW = """
let bar = document.getElementById("yam-banner");
if (!bar) {
  bar = document.createElement("div");
  bar.id = "yam-banner";
  bar.setAttribute("role", "alert");
  bar.style.cssText = "position:fixed;top:0;left:0;right:0;z-index:100000;max-height:40vh;overflow:hidden;"
    + "background:#c00;color:#fff;font:bold 17px/1.4 sans-serif;padding:0.5em 1em;text-align:center;"
    + "white-space:pre-line;pointer-events:none;box-shadow:0 2px 8px rgba(0,0,0,0.5)";
  document.body.append(bar);
}
const show = (lines) => {
  const text = lines.join("\\n");
  if (bar.textContent !== text) bar.textContent = text;
  bar.style.display = text ? "block" : "none";
  document.title = (text ? "(!) " : "") + "yam-view";
};
show(lines);
clearTimeout(window.yamSilence);
window.yamSilence = setTimeout(() => show([silent, ...lines]), silentMs);
"""
_GHOST_RAD = 0.005  # minimum distance between set-point and measured pose for drawing the ghost, rad
_EYE_M, _LOOKS_AT_M = (1.3, 1.5, 1.1), (-0.3, 0.0, 0.15)  # initial camera pose, m: two pairs of arms from the front
_LEAVE_S = 3.0  # delay before a hidden panel is removed, s: without a graphics card, a browser may draw once a second
_CAMERAS_S = 0.5
_DEVICES_S = 5.0  # search period for the processes that use video devices, s: a search reads a file per process
_NOBODY = "<p style='padding:0 0.8em;color:#888'>no arm runs on this computer</p>"


class RunJavascriptMessage(viser._messages.RunJavascriptMessage, include_in_scene_serialization=False):
    """Like viser's message of the same name, but viser keeps only the latest one for browsers that connect later."""

    def redundancy_key(self) -> str:
        """Return the same key for all messages, so that a new message replaces the previous one."""
        return "yam-view banner"


class Banner:
    """Warning bar at the top of the page, and the page title, in all browsers."""

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self._lines: list[str] = []
        self._sent_s = -_BEAT_S

    def show(self, lines: Sequence[str], now_s: float) -> None:
        """Show these lines; hide the bar if there are none. Call this often: browsers warn 4 s after the last call."""
        if list(lines) == self._lines and now_s - self._sent_s < _BEAT_S:
            return
        self._lines, self._sent_s = list(lines), now_s
        values = {"lines": self._lines, "silent": _SILENT, "silentMs": round(_SILENT_S * 1e3)}
        head = "".join(f"const {name} = {json.dumps(value)};" for name, value in values.items())
        self._server._websock_server.queue_message(RunJavascriptMessage(head + _SHOW))


class _Shown:
    """Panel and drawing of one arm on the page."""

    def __init__(self, server: viser.ViserServer, arm: WatchedArm):
        self.arm = arm
        self.panel = ArmPanel(server.gui, arm)
        self.place: Place | None = None  # pose of the arm's base, once it is drawn
        self._figure = self._ghost = None
        self._drawn: tuple[float, ...] = ()
        if arm.hardware is not None:
            root = f"/arms/{arm.key}"
            self._figure = Figure(server.scene, root, arm.hardware)
            self._ghost = Figure(server.scene, f"/setpoints/{arm.key}", arm.hardware, ghost=True)
            self._ghost.visible = False
            add_workspace(server.scene, root, arm.hardware)

    def stand(self, place: Place) -> None:
        """Move the arm's base to a place."""
        self.place = place
        for figure in (self._figure, self._ghost):
            if figure is not None:
                figure.stand(*place)

    def draw(self) -> None:
        """Draw the newest measured pose, and the set-point as a ghost if it differs."""
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
        """Remove the drawing and hide the panel, which `Live` removes later."""
        self.panel.hide()
        for figure in (self._figure, self._ghost):
            if figure is not None:
                figure.remove()


class _Cameras:
    """Folder after the arms' folders with rendered cameras in use and plugged-in cameras. Opens no camera."""

    def __init__(self, gui: viser.GuiApi):
        self._folder = gui.add_folder("cameras", order=1e6, expand_by_default=False, visible=False)
        with self._folder:
            self._text = gui.add_html("")
        self._devices: list[str] = []
        self._shown_s = -_CAMERAS_S
        self._looked_s = -_DEVICES_S

    def update(self, now_s: float, rigs: WatchedRigs) -> None:
        """Update the list of cameras every `_CAMERAS_S`. The folder is hidden if there are none."""
        if now_s - self._shown_s < _CAMERAS_S:
            return
        self._shown_s = now_s
        if now_s - self._looked_s >= _DEVICES_S:
            self._looked_s = now_s
            self._devices = [_who_reads(device) for device in video_devices()]
        lines = [html.escape(line) for line in rigs.cameras(now_s) + self._devices]
        self._folder.visible = bool(lines)
        self._text.content = f"<div style='padding:0 0.8em'>{'<br>'.join(lines)}</div>"


def _who_reads(device: VideoDevice) -> str:
    who = [f"{name} ({pid})" for pid, name in holders(device.nodes)]
    return f"{device}: {'read by ' + ', '.join(who) if who else 'no process of yours reads it'}"


class Live:
    """Part of the page that shows the arms and their faults, and contains the emergency stop.

    A slow browser delays updates until it draws, but removes elements at once. A late update of a removed element then
    causes an error in the browser's console. So panels are hidden first, and removed after the browser has drawn.

    `server`: viser's server; `troubles`: the page's own list of lines for the banner.
    """

    def __init__(self, server: viser.ViserServer, troubles: Sequence[str] = ()):
        self._server, self._troubles = server, troubles
        self._watched = WatchedArms()
        self._rigs, self._bases = WatchedRigs(server.scene), Bases(server)
        self._shown: dict[str, _Shown] = {}
        self._leaving: list[tuple[float, ArmPanel]] = []  # hidden panels: (time of removal, panel)
        server.scene.configure_default_lights(cast_shadow=False)  # shadows are slow without a graphics card
        server.initial_camera.position, server.initial_camera.look_at = _EYE_M, _LOOKS_AT_M
        self._grid = server.scene.add_grid("/floor", width=6.0, height=6.0, cell_size=0.1, section_size=0.5)
        self._banner = Banner(server)
        self._stop = StopButton(server.gui)
        self._nobody = server.gui.add_html(_NOBODY)
        self._cameras = _Cameras(server.gui)

    @property
    def arms(self) -> dict[str, WatchedArm]:
        """Channel key → running arm."""
        return self._watched.arms

    def place_of(self, key: str) -> Place | None:
        """Return the drawn pose of an arm's base, position (3,), m, and w x y z (4,), or None. `key`: channel key."""
        shown = self._shown.get(key)
        return None if shown is None else shown.place

    def update(self, now_s: float) -> None:
        """Read the arms' states and draw changes."""
        try:
            self._draw(now_s)
        finally:  # update the banner even after an error
            lines = [*self._stop.update(), *self._troubles, *self._watched.lost(now_s)]
            lines += [f"{arm.name}: {line}" for arm in self.arms.values() for line in warnings(arm)]
            lines += self._bases.warnings(now_s)
            self._banner.show(lines, now_s)

    def _draw(self, now_s: float) -> None:
        self._watched.update(now_s)
        self._bases.look(now_s)
        self._keep(now_s)
        looked_at = bool(self._server.get_clients())
        self._rigs.update(now_s, looked_at)
        mounts = self._bases.mounts
        carrying = {arm.process for arm in self.arms.values() if mount_of(arm, mounts)}
        self._bases.draw(now_s, looked_at, self._rigs, carrying)
        for key, place in places(self.arms, self._rigs.worlds, self._bases.mounts).items():
            if key in self._shown:
                self._shown[key].stand(place)
        for shown in self._shown.values():
            shown.draw()
            shown.panel.update(now_s, looked_at)
        if looked_at:
            self._cameras.update(now_s, self._rigs)

    def _keep(self, now_s: float) -> None:
        """Add and remove drawings, so that exactly the running arms and their rigs are drawn."""
        arms, before = self.arms, list(self._shown.values())
        for key in [key for key, shown in self._shown.items() if shown.arm is not arms.get(key)]:
            shown = self._shown.pop(key)
            shown.close()
            self._leaving.append((now_s + _LEAVE_S, shown.panel))
        while self._leaving and self._leaving[0][0] <= now_s:
            self._leaving.pop(0)[1].close()
        for key in sorted(arms.keys() - self._shown.keys())[:1]:  # one new arm per round: drawing it takes time
            self._shown[key] = _Shown(self._server, arms[key])
        moved = self._rigs.keep({arm.rig for arm in arms.values() if arm.rig} | self._bases.rigs)
        if not moved and before == list(self._shown.values()):
            return
        self._nobody.visible = not arms
        floors = [world.floor_z_m for world in self._rigs.worlds.values()]
        self._grid.position = (0.0, 0.0, min(floors, default=0.0))

    def close(self) -> None:
        """Release the watched sessions and rigs. Idempotent."""
        self._rigs.close()
        self._bases.close()
        self._watched.close()
