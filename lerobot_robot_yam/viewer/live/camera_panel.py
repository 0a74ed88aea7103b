"""The cameras that are known without opening any: those that a rig draws now, and those that are plugged in."""

import html

import viser

from lerobot_robot_yam.cameras.holders import holders
from lerobot_robot_yam.cameras.video_devices import VideoDevice, video_devices
from lerobot_robot_yam.viewer.live.watched_rigs import WatchedRigs

_SHOWN_S = 0.5
_LOOK_S = 5.0  # who has a device open is in as many files as there are processes


class CameraPanel:
    """A folder behind the arms.

    Args:
        gui: of the server.
    """

    def __init__(self, gui: viser.GuiApi):
        self._folder = gui.add_folder("cameras", order=1e6, expand_by_default=False, visible=False)
        with self._folder:
            self._text = gui.add_html("")
        self._devices: list[str] = []
        self._shown_s = -_SHOWN_S
        self._looked_s = -_LOOK_S

    def update(self, now_s: float, rigs: WatchedRigs) -> None:
        """Show them, now and then; the folder is there if there is one."""
        if now_s - self._shown_s < _SHOWN_S:
            return
        self._shown_s = now_s
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            self._devices = [_line(device) for device in video_devices()]
        lines = [html.escape(line) for line in rigs.cameras(now_s) + self._devices]
        self._folder.visible = bool(lines)
        self._text.content = f"<div style='padding:0 0.8em'>{'<br>'.join(lines)}</div>"


def _line(device: VideoDevice) -> str:
    who = [f"{name} ({pid})" for pid, name in holders(device.nodes)]
    return f"{device}: {'read by ' + ', '.join(who) if who else 'no process of yours reads it'}"
