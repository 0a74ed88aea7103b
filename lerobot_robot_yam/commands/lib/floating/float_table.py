"""The live table of yam-float: what each joint does, what carries it, how warm its motor is, and the loop's period."""

import math

from lerobot_robot_yam.commands.lib.arm_command import table
from lerobot_robot_yam.control.actuation import gravity_model
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.state.records import ArmState

_HEAD = ("", "rad", "rad/s", "Nm", "gravity Nm", "stage °C", "coil °C")


class FloatTable:
    """Of one arm. Ask a few times a second: the period is the mean since the last time.

    Args:
        client: the arm.
    """

    def __init__(self, client: ArmClient):
        self._client, self._gravity = client, gravity_model(client.hardware)
        self._seen: tuple[float, int] | None = None

    def show(self, state: ArmState) -> str:
        """The table as text."""
        hw = self._client.hardware
        weight: list[float] = []
        if self._gravity is not None:
            weight = (self._gravity.torque(state.q) * hw.arm.gravity_factor).tolist()
        rows = [
            [name, f"{q:+.3f}", f"{dq:+.2f}", f"{tau:+.2f}", f"{nm:+.2f}"]
            for name, q, dq, tau, nm in zip(hw.joint_names, state.q, state.dq, state.tau_nm, weight, strict=True)
        ]
        if state.gripper is not None:
            measured = (f"{state.gripper:.3f}", f"{state.gripper_rate:+.2f}", f"{state.gripper_tau_nm:+.2f}")
            rows.append(["gripper", *measured, ""])
        for row, stage, coil in zip(rows, state.temp_mos_c, state.temp_rotor_c, strict=True):
            row += [f"{stage:.0f}", f"{coil:.0f}"]
        trouble = f"  {state.message}" if state.message else ""
        name = f"{hw.name} ({hw.config.channel})"
        return f"{name}: {state.mode.name}{self._period(state)}{trouble}\n{table(_HEAD, rows)}"

    def _period(self, state: ArmState) -> str:
        before, self._seen = self._seen, (state.published_s, state.tick)
        if before is None or state.tick <= before[1]:
            return ""
        period_s = (state.published_s - before[0]) / (state.tick - before[1])
        return f"  period {period_s * 1e3:.2f} ms" if math.isfinite(period_s) else ""
