"""What is to be read about one arm: its mode, its trouble and the remedy, and a row of figures for each motor."""

import html
from collections.abc import Sequence

import numpy as np
import viser

from lerobot_robot_yam.state.faults import RESPONSES
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import ArmState, Limited
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm

_SHOWN_S = 0.2
_STYLE = "font-family:monospace;font-size:11px;width:100%;border-collapse:collapse;text-align:right"


class ArmPanel:
    """A folder of the page's panel.

    Args:
        gui: of the server.
        arm: the arm.
    """

    def __init__(self, gui: viser.GuiApi, arm: WatchedArm):
        self._arm = arm
        self._folder = gui.add_folder(arm.name)
        with self._folder:
            self._text = gui.add_html("")
        self._shown_s = -_SHOWN_S

    def update(self, now_s: float) -> None:
        """Show the state that was read last; a few times a second."""
        if now_s - self._shown_s >= _SHOWN_S:
            self._shown_s = now_s
            self._text.content = describe(self._arm)

    def close(self) -> None:
        """Take it off the page."""
        self._folder.remove()


def describe(arm: WatchedArm) -> str:
    """The panel's HTML."""
    state = arm.state
    if state is None:
        return "<p>no state yet</p>"
    lines = [f"<b>{state.mode.name}</b>, state {arm.age_s * 1e3:.0f} ms old, process {html.escape(arm.process)}"]
    lines += [f"<b style='color:#c00'>{html.escape(line)}</b>" for line in warnings(arm)]
    if state.limited:
        names = [
            flag.name.lower().replace("_", " ") for flag in Limited if flag and flag in state.limited and flag.name
        ]
        lines.append(f"limited by: {', '.join(names)}")
    if state.gate is not Gate.NONE:
        lines.append(f"gate: {state.gate.name.lower()}")
    if state.coupled:
        lines.append("follows its leader at loop rate")
    if state.trigger is not None:
        pressed = [name for name, down in zip(("top", "bottom"), state.buttons, strict=True) if down]
        lines.append(f"trigger {state.trigger:.2f}, buttons: {', '.join(pressed) or 'none'}")
    return f"<div style='padding:0 0.8em'>{'<br>'.join(lines)}{_table(arm, state)}</div>"


def warnings(arm: WatchedArm) -> list[str]:
    """What a person should know at once: one line each, with the remedy; empty when all is well."""
    state, lines = arm.state, []
    if state is None:
        return []
    if arm.stale:
        lines.append(f"NO STATE FOR {arm.age_s:.1f} s: its control loop is silent; hold the arm by hand")
    if state.trouble is not None:
        lines.append(f"{state.trouble}: {state.message}. {RESPONSES[state.trouble].rearm}")
    elif state.mode is Mode.STOPPED:
        lines.append("emergency stop: look at the arms, then release it")
    return lines


def _table(arm: WatchedArm, state: ArmState) -> str:
    hardware = arm.hardware
    names = [f"joint {number + 1}" for number in range(len(state.q))]
    names += ["gripper"] * (len(state.positions) - len(names))
    if hardware is not None:
        names = [motor.name for motor in hardware.motors][: len(names)]
    torques = [*state.tau_nm, *([] if state.gripper_tau_nm is None else [state.gripper_tau_nm])]
    rows = []
    for index, name in enumerate(names):
        limit = "" if hardware is None else f" / {hardware.torque_limit_nm[index]:.0f}"
        hottest = max(float(state.temp_mos_c[index]), float(state.temp_rotor_c[index]))
        cells = [
            f"{state.positions[index]:.3f}",
            f"{state.setpoints[index]:.3f}",
            f"{torques[index]:.1f}{limit}",
            "" if not np.isfinite(hottest) else f"{hottest:.0f}",
        ]
        rows.append(_row(name, cells))
    head = _row("", ["q rad", "set-point", "Nm / limit", "°C"])
    return f"<table style='{_STYLE}'>{head}{''.join(rows)}</table>"


def _row(name: str, cells: Sequence[str]) -> str:
    return f"<tr><td style='text-align:left'>{name}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
