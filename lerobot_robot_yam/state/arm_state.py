"""State of one arm as callers see it: unpacks a record of `STATE_DTYPE`."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import ACTION_SLOTS, STATE_DTYPE, Limited, packed

_CARRY_S = 0.05  # maximum time by which a position is carried, s: farther, its speed says nothing any more
_MOST_RAD_S2 = 60.0  # acceleration up to which `ArmState.q_error_rad` holds, rad/s²: that of a fast arm's set-point
_STATES = [packed(STATE_DTYPE, motors) for motors in range(MAX_MOTORS + 1)]
_JOINTS_AT, _MOTORS_AT = (STATE_DTYPE.fields[name][1] for name in ("joints", "motors"))  # type: ignore[index]
_MODES = {int(mode): mode for mode in Mode}
_GATES = {int(gate): gate for gate in Gate}


def _value(name: str, doc: str) -> Any:
    return property(lambda state: state._values[state._at[name]], doc=doc)


def _text(name: str, doc: str) -> Any:
    return property(lambda state: state._values[state._at[name]].rstrip(b"\0").decode(errors="replace"), doc=doc)


def _slots(name: str, doc: str, of: str = "_motors", make: Callable = tuple) -> Any:
    def get(state: "ArmState") -> Any:
        start = state._at[name]
        return make(state._values[start : start + getattr(state, of)])

    return property(get, doc=doc)


def _of_gripper(name: str, doc: str) -> Any:
    def get(state: "ArmState") -> float | None:
        return state._values[state._at[name] + state._joints] if state._motors > state._joints else None

    return property(get, doc=doc)


def _at_stamp(count: str, make: Callable, doc: str) -> Any:
    def get(state: "ArmState") -> Any:
        values, start, speed, stamp = state._values, state._at["q"], state._at["dq"], state._at["motor_stamp_s"]
        n, at_s = getattr(state, count), state.stamp_s
        if not math.isfinite(at_s):
            return make(values[start : start + n])
        return make(
            [values[start + i] + values[speed + i] * max(at_s - values[stamp + i], -_CARRY_S) for i in range(n)]
        )

    return property(get, doc=doc)


class ArmState:
    """State of one arm at `stamp_s`, to which positions are carried from each motor's sample by the motor's speed.

    Each access to an array attribute returns a new array. `q_error_rad` says how far positions may be off.

    Args:
        payload: bytes of a state record.
    """

    __slots__ = ("_at", "_joints", "_motors", "_values")

    def __init__(self, payload: bytes):
        self._joints, self._motors = payload[_JOINTS_AT], payload[_MOTORS_AT]
        layout, self._at = _STATES[self._motors]
        self._values = layout.unpack(payload)

    def __repr__(self) -> str:
        q = ", ".join(f"{value:.3f}" for value in self.q)
        grip = "" if self.gripper is None else f", gripper={self.gripper:.2f}"
        wrong = f", {self.trouble}: {self.message}" if self.trouble else ""
        return f"<ArmState {self.mode.name} q=[{q}] rad{grip}, hottest {max(self.temp_mos_c):.0f} °C{wrong}>"

    q: np.ndarray = _at_stamp("_joints", np.array, "(joints,) rad.")
    dq: np.ndarray = _slots("dq", "(joints,) rad/s.", "_joints", np.array)
    tau_nm: np.ndarray = _slots("tau", "(joints,) Nm in joint coordinates.", "_joints", np.array)
    setpoint_q: np.ndarray = _slots("setpoint", "(joints,) rad.", "_joints", np.array)

    positions: tuple[float, ...] = _at_stamp(
        "_motors", tuple, "Joints in rad; behind them the gripper, 0 … 1, if it has a motor."
    )
    setpoints: tuple[float, ...] = _slots("setpoint", "As `positions`, of the set-point.")

    gripper_rate: float | None = _of_gripper("dq", "1/s; None without a gripper motor.")
    gripper_tau_nm: float | None = _of_gripper("tau", "Motor torque; None without a gripper motor.")
    gripper_setpoint: float | None = _of_gripper("setpoint", "0 … 1; None without a gripper motor.")

    motor_stamps_s: np.ndarray = _slots("motor_stamp_s", "(n,) monotonic time of each motor's sample.", make=np.array)
    stamp_s: float = _slots("motor_stamp_s", "Monotonic time of the oldest of these samples.", make=min)
    asked_s: float = _value("asked_s", "Monotonic time of the oldest command that a sample answers.")
    published_s: float = _value("stamp_s", "Monotonic time at which the control loop wrote this state.")
    tick: int = _value("tick", "Number of the control loop's tick.")

    temp_mos_c: np.ndarray = _slots("temp_mos_c", "(n,) °C per motor, power stage.", make=np.array)
    temp_rotor_c: np.ndarray = _slots("temp_rotor_c", "(n,) °C per motor, coil.", make=np.array)
    fault: tuple[int, ...] = _slots("fault", "Per motor, code of `damiao.tables.Fault`.")
    lost: tuple[int, ...] = _slots("lost", "Per motor, replies lost since connecting.")

    coupled_to: int = _value("coupled_to", "`coupling_number` of the leader that a follower follows; 0: none.")

    answered: int = _value("request_sequence", "Number of the newest request that was carried out or refused.")
    message: str = _text("message", "Why the arm is in its mode, empty when all is well.")
    _refusal: str = _text("refusal", "Why the newest refused request was refused.")
    _trouble: str = _text("trouble", "Value of a `Trouble`, empty when all is well.")

    @property
    def gripper(self) -> float | None:
        """0 closed … 1 open; None without a gripper motor."""
        return self.positions[-1] if self._motors > self._joints else None

    @property
    def q_error_rad(self) -> float:
        """Maximum error of `q` at `stamp_s`, rad, beyond a step of the encoder, up to 60 rad/s² of acceleration.

        At most 0.002, unless replies got lost while the arm moved, or the adapter has just become slower.
        """
        values, at, stamp_s = self._values, self._at, self.stamp_s
        speed, sampled, doubt = at["dq"], at["motor_stamp_s"], at["stamp_doubt_s"]
        return max(
            abs(values[speed + i]) * values[doubt + i]
            + 0.5 * _MOST_RAD_S2 * (values[sampled + i] - stamp_s + values[doubt + i]) ** 2
            for i in range(self._joints)
        )

    @property
    def mode(self) -> Mode:
        """Present mode of the arm."""
        return _MODES[self._values[self._at["mode"]]]

    @property
    def limited(self) -> Limited:
        return Limited(self._values[self._at["limited"]])

    @property
    def gripper_stops_rad(self) -> tuple[float, float] | None:
        """Motor angles of the gripper's stops, closed and open, rad; None while unknown."""
        start = self._at["gripper_stops_rad"]
        closed, opened = self._values[start : start + 2]
        return None if math.isnan(closed) else (closed, opened)

    @property
    def trigger(self) -> float | None:
        """Trigger of the teaching handle, 0 released … 1 squeezed; None: no handle, or the handle is silent."""
        value = self._values[self._at["trigger"]]
        return None if math.isnan(value) else value

    @property
    def buttons(self) -> tuple[bool, bool]:
        """Buttons of the teaching handle; True: pressed."""
        first = self._at["buttons"]
        return bool(self._values[first]), bool(self._values[first + 1])

    @property
    def presses(self) -> tuple[int, int]:
        """Number of presses of each button since the control loop began, however short they were."""
        first = self._at["presses"]
        return self._values[first], self._values[first + 1]

    @property
    def gate(self) -> Gate:
        """State of a leader's gate; NONE if the arm leads no follower."""
        return _GATES[self._values[self._at["gate"]]]

    @property
    def action(self) -> tuple[float, ...] | None:
        """Target of a follower: joints in rad, then the gripper, 0 … 1; None: no target.

        In a leader's state: the target for its follower. In a follower's state: the newest target accepted by its
        set-point.
        """
        first = self._at["action"]
        values = self._values[first : first + ACTION_SLOTS]
        given = next((count for count, value in enumerate(values) if math.isnan(value)), ACTION_SLOTS)
        return values[:given] or None

    @property
    def coupled(self) -> bool:
        """Whether a follower reads its targets directly from a leader's state."""
        return self.coupled_to != 0

    @property
    def trouble(self) -> Trouble | None:
        """Fault of the arm; None: no fault."""
        return Trouble(self._trouble) if self._trouble else None

    @property
    def refusal(self) -> str | None:
        """Reason for the refusal of the newest request; None if the request was executed."""
        return self._refusal if self._values[self._at["request_refused"]] else None
