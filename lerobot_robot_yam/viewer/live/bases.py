"""Mobile bases that run on this computer: the state of each in a folder, and a box where its odometry has it."""

import contextlib
import html
import math

import viser

from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.mobile.base_profile import BaseProfile
from lerobot_robot_yam.state.base_records import BASE_STATE_DTYPE, BaseState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.runtime_files import STATE, runtime_dir, sessions
from lerobot_robot_yam.system.shared_block import SharedBlock

_LOOK_S, _SHOWN_S = 0.5, 0.25
_OLD_S = 0.25  # age of a state, s, from which it is a warning
_BOX_M = (0.56, 0.5, 0.18)  # size of a chassis, m: our choice, as on the rig
_COLOUR = (60, 66, 75)


class _ShownBase:
    """Folder and box of one base. Nothing is written or requested."""

    def __init__(self, server: viser.ViserServer, key: str, block: SharedBlock):
        self.block, self._key = block, key
        self._state: BaseState | None = None
        self._box = server.scene.add_box(f"/bases/{key}", color=_COLOUR, dimensions=_BOX_M)
        self._folder = server.gui.add_folder(f"base ({key})")
        with self._folder:
            self._text = server.gui.add_html("")

    def draw(self, looked_at: bool) -> None:
        record = self.block.glance()
        if record is None:
            return
        self._state = state = BaseState(record)
        x, y, heading = state.pose.tolist()
        self._box.position = x, y, BaseProfile().radius_m + _BOX_M[2] / 2
        self._box.wxyz = math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)
        if looked_at:
            self._text.content = describe(state)

    def warnings(self, now_s: float) -> list[str]:
        state = self._state
        if state is None or state.mode is Mode.OFF:
            return []
        age_s = now_s - state.asked_s
        lines = [f"NO STATE FOR {age_s:.1f} s: its loop is silent, it may roll"] if age_s > _OLD_S else []
        return [f"base ({self._key}): {line}" for line in [*lines, *filter(None, [state.message])]]

    def close(self) -> None:
        self.block.close(remove=False)
        for part in (self._text, self._folder, self._box):
            part.remove()


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
    """All running bases. Call `update` once per round."""

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self._shown: dict[str, _ShownBase] = {}
        self._looked_s = self._drawn_s = -math.inf

    def update(self, now_s: float, looked_at: bool) -> None:
        """Draw changes; every `_LOOK_S` also search for bases that have started or ended."""
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            self._look()
        show = looked_at and now_s - self._drawn_s >= _SHOWN_S
        self._drawn_s = now_s if show else self._drawn_s
        for base in self._shown.values():
            base.draw(show)

    def _look(self) -> None:
        directory = runtime_dir()
        running = sessions(directory)
        for key in [key for key, base in self._shown.items() if key not in running or not base.block.current]:
            self._shown.pop(key).close()
        for key in running.keys() - self._shown.keys():
            with contextlib.suppress(FileNotFoundError, StaleStateError):  # an arm, or a session that starts or ends
                block = SharedBlock(directory / f"{STATE}{key}", BASE_STATE_DTYPE, create=False)
                self._shown[key] = _ShownBase(self._server, key, block)

    def warnings(self, now_s: float) -> list[str]:
        """Return one line for each urgent problem."""
        return [line for base in self._shown.values() for line in base.warnings(now_s)]

    def close(self) -> None:
        """Remove all bases. Idempotent."""
        for key in list(self._shown):
            self._shown.pop(key).close()
