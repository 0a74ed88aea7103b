"""What is to be read about one arm: its mode, its trouble and the remedy, and a row of figures for each motor."""

import html
import math
from collections.abc import Sequence

import viser

from lerobot_robot_yam.control.safety.thermal_monitor import COIL_TRIP_C, MOS_TRIP_C, WARM_C
from lerobot_robot_yam.state.faults import RESPONSES
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import ArmState, Limited
from lerobot_robot_yam.viewer.live.arm_plot import ArmPlot
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm

_SHOWN_S = 0.2
_NEAR = 0.8  # of a torque limit
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
        self._plot: ArmPlot | None = None  # once it is known how many motors there are
        self._gui = gui
        self._shown_s = -_SHOWN_S

    def update(self, now_s: float, looked_at: bool) -> None:
        """Show the state that was read last, a few times a second while somebody looks; it is plotted all the same."""
        state = self._arm.state
        if state is None:
            return
        if self._plot is None:
            with self._folder:
                self._plot = ArmPlot(self._gui, motor_names(self._arm, state))
        self._plot.history.add(state)
        if looked_at and now_s - self._shown_s >= _SHOWN_S:
            self._shown_s = now_s
            self._text.content = describe(self._arm)
            self._plot.update(now_s)

    def hide(self) -> None:
        """It is not updated any more."""
        self._folder.visible = False

    def close(self) -> None:
        """Take it off the page; first what is in it, so that no update is on its way to something that is gone."""
        if self._plot is not None:
            self._plot.close()
        self._text.remove()
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
    elif state.mode is Mode.FAULT:
        lines.append(f"FAULT: {state.message}")
    elif state.mode is Mode.STOPPED:
        lines.append("emergency stop: look at the arms, then release it")
    return lines


def motor_names(arm: WatchedArm, state: ArmState) -> list[str]:
    """As the profiles call them; (n)."""
    if arm.hardware is not None and arm.hardware.n == len(state.positions):
        return [motor.name for motor in arm.hardware.motors]
    joints, motors = len(state.q), len(state.positions)
    return [f"joint{number + 1}" for number in range(joints)] + ["gripper"] * (motors - joints)


def _table(arm: WatchedArm, state: ArmState) -> str:
    hardware = arm.hardware
    torques = [*state.tau_nm, *([] if state.gripper_tau_nm is None else [state.gripper_tau_nm])]
    rows = [_row("", ["q", "set-point", "Nm", "of", "mos °C", "coil °C"])]
    for index, name in enumerate(motor_names(arm, state)):
        limit = math.inf if hardware is None or index >= hardware.n else float(hardware.torque_limit_nm[index])
        mos, coil = float(state.temp_mos_c[index]), float(state.temp_rotor_c[index])
        cells = [
            f"{state.positions[index]:.3f}",
            f"{state.setpoints[index]:.3f}",
            _marked(f"{torques[index]:.1f}", abs(torques[index]) > _NEAR * limit),
            "" if limit == math.inf else f"{limit:.0f}",
            _marked(f"{mos:.0f}", mos > MOS_TRIP_C - WARM_C),
            _marked(f"{coil:.0f}", coil > COIL_TRIP_C - WARM_C),
        ]
        rows.append(_row(name, cells))
    return f"<table style='{_STYLE}'>{''.join(rows)}</table>"


def _marked(text: str, bad: bool) -> str:
    return f"<b style='color:#c00'>{text}</b>" if bad else text


def _row(name: str, cells: Sequence[str]) -> str:
    return f"<tr><td style='text-align:left'>{name}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
