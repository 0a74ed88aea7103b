"""Mobile bases that run on this computer: the state of each in a folder, and boxes where rig or odometry have it."""

import contextlib
import html
import math
from collections.abc import Container

import numpy as np
import viser

from lerobot_robot_yam.arm.config import VIRTUAL
from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.mobile.base_profile import BaseProfile
from lerobot_robot_yam.rig.world.base_model import CHASSIS_M, CHASSIS_UP_M, COLUMN_M, MOUNT_M, PLATE_M
from lerobot_robot_yam.state.about import read_about
from lerobot_robot_yam.state.base_records import BASE_STATE_DTYPE, BaseState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.runtime_dirs import STATE, sessions
from lerobot_robot_yam.system.runtime_files import runtime_dir, slug
from lerobot_robot_yam.system.shared_block import SharedBlock
from lerobot_robot_yam.viewer.figure import Place, on, put
from lerobot_robot_yam.viewer.live.watched_rigs import WatchedRigs

_LOOK_S, _SHOWN_S = 0.5, 0.25
_OLD_S = 0.25  # age of a state, s, from which it is a warning
_COLOUR, _STAND_COLOUR = (60, 66, 75), (140, 145, 153)
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


class _ShownBase:
    """Folder and boxes of one base, sized as on the rig. Nothing is written or requested.

    Attributes:
        process: process that drives the base.
        rig: name of the base's virtual rig; None for a real base.
        mount: place of the mount, on which arms ride; None before the first state.
    """

    def __init__(self, server: viser.ViserServer, key: str, process: str, block: SharedBlock):
        self.block, self.process, self._key = block, process, key
        about = read_about(runtime_dir(), key) or {}
        self._channel = str(about.get("channel"))
        virtual = about.get("interface") == VIRTUAL
        self.rig = key.removesuffix(f".{slug(self._channel)}") if virtual else None
        self.mount: Place | None = None
        self._state: BaseState | None = None
        root = f"/bases/{key}"
        self._frame = server.scene.add_frame(root, show_axes=False)
        self._mount = server.scene.add_frame(f"/mounts/{key}", show_axes=False, visible=False)
        _add_box(server.scene, f"{root}/chassis", _COLOUR, CHASSIS_M, CHASSIS_UP_M)
        _add_box(server.scene, f"/mounts/{key}/plate", _STAND_COLOUR, PLATE_M, -PLATE_M[2])
        _add_box(server.scene, f"/mounts/{key}/column", _STAND_COLOUR, COLUMN_M, -COLUMN_M[2])
        self._folder = server.gui.add_folder(f"base ({key})")
        with self._folder:
            self._text = server.gui.add_html("")

    def draw(self, looked_at: bool, rigs: WatchedRigs) -> None:
        record = self.block.glance()
        if record is None:
            return
        self._state = state = BaseState(record)
        base, self.mount = (self.rig and rigs.base(self.rig, self._channel)) or by_odometry(state)
        put(self._frame, *base)
        put(self._mount, *self.mount)
        if looked_at:
            self._text.content = describe(state)

    def carry(self, carries: bool) -> None:
        """Show the stand of the arms, or hide it."""
        if self._mount.visible != carries:
            self._mount.visible = carries

    def warnings(self, now_s: float) -> list[str]:
        state = self._state
        if state is None or state.mode is Mode.OFF:
            return []
        age_s = now_s - state.asked_s
        lines = [f"NO STATE FOR {age_s:.1f} s: its loop is silent, it may roll"] if age_s > _OLD_S else []
        return [f"base ({self._key}): {line}" for line in [*lines, *filter(None, [state.message])]]

    def close(self) -> None:
        self.block.close(remove=False)
        for part in (self._text, self._folder, self._frame, self._mount):
            part.remove()


def _add_box(
    scene: viser.SceneApi, name: str, colour: tuple[int, int, int], half_m: tuple[float, float, float], up_m: float
) -> None:
    scene.add_box(name, color=colour, dimensions=2.0 * np.array(half_m), position=(0.0, 0.0, up_m))


def by_odometry(state: BaseState) -> tuple[Place, Place]:
    """Return the places of a base and of its mount, on a floor at z = 0; the mount's as on the rig, our choice."""
    x, y, heading = state.pose.tolist()
    base = np.array([x, y, BaseProfile().radius_m]), np.array([math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)])
    height_m = 0.0 if state.rail is None else np.nan_to_num(state.rail.height_m)
    return base, on(base, (np.add(MOUNT_M, [0.0, 0.0, height_m]), _UPRIGHT))


def describe(state: BaseState) -> str:
    """Return the HTML of a base's folder."""
    x, y, heading = state.pose.tolist()
    vx, vy, omega = state.body_twist.tolist()
    lines = [
        f"<b>{state.mode.name}</b>",
        f"odometry {x:.3f} m, {y:.3f} m, {math.degrees(heading):.1f}°",
        f"velocity {vx:.2f} m/s, {vy:.2f} m/s, {math.degrees(omega):.1f}°/s",
    ]
    if state.rail is not None:
        brake = "on" if state.rail.brake_on else "off"
        lines.append(f"rail {state.rail.height_m:.3f} m{'' if state.rail.homed else ', not homed'}, brake {brake}")
    faults = {fault_text(fault) for fault in state.fault if fault not in (Fault.NORMAL, Fault.DISABLED)}
    lines += [f"<b style='color:#c00'>{html.escape(line)}</b>" for line in [*sorted(faults), state.message] if line]
    return f"<div style='padding:0 0.8em'>{'<br>'.join(lines)}</div>"


class Bases:
    """All running bases. Call `look` and then `draw` once per round."""

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self._shown: dict[str, _ShownBase] = {}
        self._looked_s = self._drawn_s = -math.inf

    @property
    def rigs(self) -> set[str]:
        """Names of the virtual rigs of the bases."""
        return {base.rig for base in self._shown.values() if base.rig is not None}

    @property
    def mounts(self) -> dict[str, Place]:
        """Process → place of the mount of the base that it drives."""
        return {base.process: base.mount for base in self._shown.values() if base.mount is not None}

    def draw(self, now_s: float, looked_at: bool, rigs: WatchedRigs, carrying: Container[str]) -> None:
        """Draw changes. carrying: processes that drive an arm on a base, too."""
        show = looked_at and now_s - self._drawn_s >= _SHOWN_S
        self._drawn_s = now_s if show else self._drawn_s
        for base in self._shown.values():
            base.draw(show, rigs)
            base.carry(base.process in carrying)

    def look(self, now_s: float) -> None:
        """Search every `_LOOK_S` for bases that have started or ended."""
        if now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        directory = runtime_dir()
        running = sessions(directory)
        for key in [key for key, base in self._shown.items() if key not in running or not base.block.current]:
            self._shown.pop(key).close()
        for key in running.keys() - self._shown.keys():
            with contextlib.suppress(FileNotFoundError, StaleStateError):  # an arm, or a session that starts or ends
                block = SharedBlock(directory / f"{STATE}{key}", BASE_STATE_DTYPE, create=False)
                self._shown[key] = _ShownBase(self._server, key, running[key], block)

    def warnings(self, now_s: float) -> list[str]:
        """Return one line for each urgent problem."""
        return [line for base in self._shown.values() for line in base.warnings(now_s)]

    def close(self) -> None:
        """Remove all bases. Idempotent."""
        for key in list(self._shown):
            self._shown.pop(key).close()
