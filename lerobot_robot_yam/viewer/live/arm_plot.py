"""A plot of the last ten seconds of one arm: one joint and one quantity, which the reader picks."""

import math
from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from lerobot_robot_yam.state.records import ArmState

_SPAN_S = 10.0
_ROWS = 512  # of a ring; more than a page reads in that time
_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c")
_POSITION, _TORQUE, _PERIOD, _AGE = "q, set-point, target", "torque, Nm", "loop period, ms", "sample age, ms"
_CURVES = {
    _POSITION: ("q", "set-point", "target"),
    _TORQUE: ("torque",),
    _PERIOD: ("mean period",),
    _AGE: ("oldest sample",),
}


class ArmHistory:
    """A ring of samples of one arm with n motors, its joints in rad and then the gripper, 0 … 1.

    Columns: n each of q, set-point, target and torque (Nm), then the loop's period and the age of its samples, ms.
    """

    def __init__(self, motors: int):
        self._n = motors
        self._times = np.zeros(_ROWS)
        self._values = np.zeros((_ROWS, 4 * motors + 2))
        self._count = 0
        self._last: ArmState | None = None

    def add(self, state: ArmState) -> None:
        """Take a state, unless it is the one before or lacks a reading."""
        last, self._last = self._last, state
        if last is None or state.tick <= last.tick:
            return
        setpoint = state.setpoints
        action = state.action or ()
        target = action if len(action) == self._n else setpoint  # a leader's is for its follower, which has a gripper
        grip = state.gripper_tau_nm
        row = [*state.positions, *setpoint, *target, *state.tau_nm, *([] if grip is None else [grip])]
        row.append(1e3 * (state.published_s - last.published_s) / (state.tick - last.tick))
        row.append(1e3 * (state.published_s - state.stamp_s))
        if all(map(math.isfinite, row)):
            index = self._count % _ROWS
            self._times[index], self._values[index] = state.published_s, row
            self._count += 1

    def columns(self, now_s: float, *numbers: int) -> tuple[np.ndarray, ...]:
        """Seconds before now, (k,) from -10 to 0, and the values of some columns, (k,) each, oldest first."""
        kept = min(self._count, _ROWS)
        rows = np.arange(self._count - kept, self._count) % _ROWS
        rows = rows[self._times[rows] > now_s - _SPAN_S]
        return self._times[rows] - now_s, *(self._values[rows, number] for number in numbers)


class ArmPlot:
    """Two menus and the plot, in the folder that is open.

    Args:
        gui: of the server.
        names: of the arm's motors.

    Attributes:
        history: what is plotted; to be filled.
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
        """Draw it."""
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
        """Take it off the page."""
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
