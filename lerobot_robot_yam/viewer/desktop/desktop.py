"""MuJoCo's own viewer on the arms that run on this computer; it can drive those that it has started."""

import queue
import time
import warnings

import glfw
import mujoco.viewer

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.viewer.desktop.desktop_scene import DesktopScene
from lerobot_robot_yam.viewer.desktop.drag_control import DragControl
from lerobot_robot_yam.viewer.live.arm_panel import warnings as warnings_of
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArms

_PERIOD_S = 0.02
_SPACE = 32  # GLFW's number of the key
HELP = (
    "SPACE: watch or control. To move a tool: double-click its orange box, then Ctrl and drag (right: move, left: turn)"
)


def need_display() -> None:
    """Refuse where there is none; MuJoCo's viewer would wait for ever.

    Raises:
        ConfigError: no window can be opened.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        opened = glfw.init()
    if not opened:
        _, why = glfw.get_error()
        text = why.decode(errors="replace") if isinstance(why, bytes) else "no display"
        raise ConfigError(f"--desktop needs a screen ({text}); without one use yam-view and a browser")


class Desktop:
    """What the window shows, apart from the window.

    Args:
        control: of arms that can be driven; None: it only watches.

    Attributes:
        scene: as it is now.
    """

    def __init__(self, control: DragControl | None = None):
        self._control = control
        self._watched = WatchedArms()
        self._typed: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._shown: dict[str, str] = {}
        self.scene = DesktopScene({})
        self.look()

    def look(self) -> bool:
        """Read the states of all arms; returns whether others run now, and the scene is a new one."""
        self._watched.update(time.monotonic())
        known = {key: arm.hardware for key, arm in self._watched.arms.items() if arm.hardware is not None}
        shown = {key: self._watched.arms[key].process for key in known}
        if shown == self._shown:
            return False
        self._shown = shown
        if self._control is not None and self._control.on:
            self._control.watch("other arms have come or gone")
        self.scene = DesktopScene(known, self._control.keys if self._control else ())
        return True

    def type(self, key: int) -> None:
        """A key of the window, by GLFW's number; on any thread."""
        self._typed.put(key)

    def update(self) -> None:
        """Pose the arms as they were read last, and drive those that are driven."""
        for key in self._shown:
            arm = self._watched.arms.get(key)
            if arm is not None and arm.state is not None:
                self.scene.show(key, arm.state.q, arm.state.gripper)
        self.scene.refresh()
        while not self._typed.empty():
            if self._typed.get() == _SPACE and self._control is not None:
                self._control.toggle()
        if self._control is not None and set(self._control.keys) <= set(self._shown):
            self._control.update(self.scene)

    def texts(self) -> tuple[str, str]:
        """What stands in the corner: two columns."""
        left = "watching" if self._control is None or not self._control.on else "CONTROL"
        lines = [f"{arm.name}: {line}" for arm in self._watched.arms.values() for line in warnings_of(arm)]
        if not self._watched.arms:
            lines.append("no arm runs on this computer")
        if self._control is not None:
            lines += [self._control.said] * bool(self._control.said) + [HELP]
        return left, "\n".join(lines)

    def close(self) -> None:
        """Let go of the sessions. Idempotent."""
        self._watched.close()


def run_desktop(control: DragControl | None = None) -> None:
    """Until a person closes the window. When arms come or go a new window takes the place of the old one."""
    desktop = Desktop(control)
    try:
        while _one_window(desktop):
            pass
    finally:
        desktop.close()


def _one_window(desktop: Desktop) -> bool:
    """A window on the present scene; returns whether another one is needed."""
    scene = desktop.scene
    with mujoco.viewer.launch_passive(
        scene.model, scene.data, key_callback=desktop.type, show_left_ui=False, show_right_ui=False
    ) as window:
        window.cam.lookat, window.cam.distance, window.cam.azimuth, window.cam.elevation = [0.2, 0, 0.2], 1.8, 140, -25
        while window.is_running():
            if desktop.look():
                return True
            with window.lock():
                desktop.update()
            window.set_texts((None, None, *desktop.texts()))
            window.sync()
            time.sleep(_PERIOD_S)
    return False
