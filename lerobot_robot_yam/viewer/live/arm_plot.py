"""A plot of the last ten seconds of one arm: one joint and one quantity, which the reader picks."""

from collections.abc import Sequence

import viser
from viser import uplot

from lerobot_robot_yam.viewer.live.arm_history import SPAN_S, ArmHistory

_SHOWN_S = 0.2
_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c")
_POSITION, _TORQUE, _PERIOD, _AGE = "q, set-point, target", "torque, Nm", "loop period, ms", "sample age, ms"
_CURVES = {
    _POSITION: ("q", "set-point", "target"),
    _TORQUE: ("torque",),
    _PERIOD: ("mean period",),
    _AGE: ("oldest sample",),
}


class ArmPlot:
    """Two menus and the plot, in the folder that is open.

    Args:
        gui: of the server.
        names: of the arm's motors.
    """

    def __init__(self, gui: viser.GuiApi, names: Sequence[str]):
        self._gui, self._names = gui, list(names)
        self._history = ArmHistory(len(names))
        self._folder = gui.add_folder("last 10 s")
        with self._folder:
            self._quantity = gui.add_dropdown("plot", list(_CURVES))
            self._motor = gui.add_dropdown("of", self._names)
        self._drawn = ""
        self._plot: viser.GuiUplotHandle | None = None
        self._shown_s = -_SHOWN_S

    @property
    def history(self) -> ArmHistory:
        """What is plotted; to be filled."""
        return self._history

    def update(self, now_s: float) -> None:
        """Draw it, a few times a second."""
        if now_s - self._shown_s < _SHOWN_S:
            return
        self._shown_s = now_s
        quantity, motor = self._quantity.value, self._names.index(self._motor.value)
        data = self._history.columns(now_s, *self._columns(quantity, motor))
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
                scales={"x": uplot.Scale(time=False, range=(-SPAN_S, 0.0))},
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
