"""Panel of one arm: mode, fault with remedy, a table of motor values, and a plot of the last ten seconds."""

import html
import math
from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from lerobot_robot_yam.control.safety.thermal_monitor import COIL_TRIP_C, MOS_TRIP_C, WARM_C
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.faults import RESPONSES
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArm

_SPAN_S = 10.0
_ROWS = 512  # ring buffer size: more samples than a page reads in `_SPAN_S`
_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c")
_POSITION, _TORQUE, _PERIOD, _AGE = "q, set-point, target", "torque, Nm", "loop period, ms", "sample age, ms"
_CURVES = {
    _POSITION: ("q", "set-point", "target"),
    _TORQUE: ("torque",),
    _PERIOD: ("mean period",),
    _AGE: ("oldest sample",),
}
_SHOWN_S = 0.2
_NEAR = 0.8  # fraction of the torque limit above which a torque is highlighted
_STYLE = "font-family:monospace;font-size:11px;width:100%;border-collapse:collapse;text-align:right"


class ArmHistory:
    """Ring buffer of samples from one arm with n motors: joints in rad, then the gripper, 0 … 1.

    Columns: n each of q, set-point, target and torque (Nm), then loop period and sample age, ms.
    """

    def __init__(self, motors: int):
        self._n = motors
        self._times = np.zeros(_ROWS)
        self._values = np.zeros((_ROWS, 4 * motors + 2))
        self._count = 0
        self._last: ArmState | None = None

    def add(self, state: ArmState) -> None:
        """Add a state, unless it is not newer than the last one or lacks a reading."""
        last, self._last = self._last, state
        if last is None or state.tick <= last.tick:
            return
        setpoint = state.setpoints
        action = state.action or ()
        target = action if len(action) == self._n else setpoint  # a leader's action includes its follower's gripper
        grip = state.gripper_tau_nm
        row = [*state.positions, *setpoint, *target, *state.tau_nm, *([] if grip is None else [grip])]
        row.append(1e3 * (state.published_s - last.published_s) / (state.tick - last.tick))
        row.append(1e3 * (state.published_s - state.stamp_s))
        if all(map(math.isfinite, row)):
            index = self._count % _ROWS
            self._times[index], self._values[index] = state.published_s, row
            self._count += 1

    def columns(self, now_s: float, *numbers: int) -> tuple[np.ndarray, ...]:
        """Return times relative to now (k,), -10 to 0 s, and the values (k,) of each requested column, oldest first."""
        kept = min(self._count, _ROWS)
        rows = np.arange(self._count - kept, self._count) % _ROWS
        rows = rows[self._times[rows] > now_s - _SPAN_S]
        return self._times[rows] - now_s, *(self._values[rows, number] for number in numbers)


class ArmPlot:
    """Plot of one quantity for one motor, with a menu for each, in the open folder.

    `gui`: the server's gui; `names`: names of the motors.

    Attributes:
        history: samples to plot, added by the caller.
    """

    def __init__(self, gui: viser.GuiApi, names: Sequence[str]):
        self._gui, self._names = gui, list(names)
        self.history = ArmHistory(len(names))
        self._folder = gui.add_folder("last 10 s")
        with self._folder:
            self._quantity = gui.add_dropdown("plot", list(_CURVES))
            self._motor = gui.add_dropdown("of", self._names)
        self._drawn = ""
        self._plot: viser.GuiUplotHandle | None = None

    def update(self, now_s: float) -> None:
        """Redraw the plot from the history."""
        quantity, motor = self._quantity.value, self._names.index(self._motor.value)
        data = self.history.columns(now_s, *self._columns(quantity, motor))
        if len(data[0]) < 2:
            return
        if self._plot is not None and self._drawn == quantity:
            self._plot.data = data
            return
        if self._plot is not None:
            self._plot.remove()
        self._drawn, self._motor.visible = quantity, quantity in (_POSITION, _TORQUE)
        with self._folder:
            self._plot = self._gui.add_uplot(
                data,
                (uplot.Series(label="s"), *self._series(quantity)),
                scales={"x": uplot.Scale(time=False, range=(-_SPAN_S, 0.0))},
                height=170,
            )

    def close(self) -> None:
        """Remove the plot from the page."""
        if self._plot is not None:
            self._plot.remove()
        self._folder.remove()

    def _columns(self, quantity: str, motor: int) -> list[int]:
        n = len(self._names)
        return {_POSITION: [motor, n + motor, 2 * n + motor], _TORQUE: [3 * n + motor], _PERIOD: [4 * n]}.get(
            quantity, [4 * n + 1]
        )

    @staticmethod
    def _series(quantity: str) -> list[uplot.Series]:
        pairs = zip(_CURVES[quantity], _COLOURS, strict=False)
        return [uplot.Series(label=label, stroke=colour, width=1.5) for label, colour in pairs]


class ArmPanel:
    """Folder of one arm on the page."""

    def __init__(self, gui: viser.GuiApi, arm: WatchedArm):
        self._arm = arm
        self._folder = gui.add_folder(arm.name)
        with self._folder:
            self._text = gui.add_html("")
        self._plot: ArmPlot | None = None  # created with the first state, which gives the number of motors
        self._gui = gui
        self._shown_s = -_SHOWN_S

    def update(self, now_s: float, looked_at: bool) -> None:
        """Add the newest state to the plot. While a browser is connected, also redraw a few times a second."""
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
        """Hide the folder."""
        self._folder.visible = False

    def close(self) -> None:
        """Remove the panel from the page, contents first, so that no update is sent to a removed element."""
        if self._plot is not None:
            self._plot.close()
        self._text.remove()
        self._folder.remove()


def describe(arm: WatchedArm) -> str:
    """Return the panel's HTML."""
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
    """Return one line with the remedy for each urgent problem of an arm."""
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
    """Return the motor names (n), from the profiles if they match the state, else numbered."""
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
