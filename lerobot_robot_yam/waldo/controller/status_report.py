"""Statuses of the controller's arm as plain values, 100 per second, and queries for parts of a status.

Lengths in mm, angles in deg, joint speeds in rad/s, torques in Nm, as in Commander's contract. A status also lists
the enabled jog buttons: for joints not at their limits, and for directions in which the tool can move a little.
"""

import asyncio
import os
from collections import deque
from typing import Any

import numpy as np

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.waldo.arm_choice import NO_TOOL
from lerobot_robot_yam.waldo.controller.client_requests import SettingRequests
from lerobot_robot_yam.waldo.controller.controller import TICK_S, Controller
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import FRAMES, check_frame, commanded, to_command
from lerobot_robot_yam.waldo.program import swapped

STATUS_HZ = 100  # status rate, Hz: the contract's maximum, so that one late status makes no gap of 30 ms
_PROBE_S = 0.2  # delay between two checks of the tool's free directions, s
_MOVED_RAD = 1e-3  # joint motion since the last check that makes a new check necessary, rad
_AHEAD_S = 1e-3  # time step of the finite difference for the tool's speed, s
_LATE_S = 2.0 * TICK_S
_IDLE, _EXECUTING, _ERROR = 0, 1, 2  # values of Commander's ActionState
_TOOL_OFF, _TOOL_IDLE, _TOOL_ACTIVE = 0, 1, 2  # values of Commander's ToolState
_FAULT_CODE, _STOP_CODE = 1, 2  # warning codes
_BAND_RAD = np.radians(1.0)  # distance below which a joint counts as at its limit, rad
_PROBES = np.array([5.0] * 3 + [1.0] * 3)  # steps of the tool to check, mm and degrees
_JUMP_RAD = 0.5  # joint distance beyond which an IK solution belongs to another arm configuration, rad


class StatusReport:
    """Status generator of one controller."""

    def __init__(self, controller: Controller, settings: SettingRequests):
        self._controller, self._settings = controller, settings
        self._prober = Planner(controller.hardware)
        self._open: dict[str, list[int]] = {frame: [1] * 12 for frame in FRAMES}
        self._probed: tuple[np.ndarray, np.ndarray] | None = None
        self._ticks: deque[float] = deque(maxlen=500)

    def ticked(self) -> None:
        """Record the time of a controller tick."""
        self._ticks.append(self._controller.now())

    async def probe_on(self) -> None:
        """Check repeatedly, in a thread, in which directions the tool can move. Runs until cancelled."""
        while True:
            q, tip = self._controller.reading.q.copy(), self._controller.tip
            moved = self._probed is None or np.abs(self._probed[0] - q).max() > _MOVED_RAD
            if moved or self._probed is None or self._probed[1] is not tip:
                self._open = await asyncio.to_thread(self._probe, q, tip)
                self._probed = q, tip
            await asyncio.sleep(_PROBE_S)

    def _probe(self, q: np.ndarray, tip: np.ndarray) -> dict[str, list[int]]:
        self._prober.kinematics.tool = tip
        return {frame: found.tolist() for frame, found in axes_enabled(self._prober, q).items()}

    # queries

    def ping(self) -> dict[str, Any]:
        controller = self._controller
        return {
            "hardware_connected": controller.ready_hardware,
            "simulator": controller.in_simulator,
            "pid": os.getpid(),
            "session_id": controller.session_id,
            "arm": controller.hardware.arm.name,
            "gripper": controller.hardware.gripper.name,
        }

    def angles(self) -> list[float]:
        return _listed(np.degrees(self._controller.reading.q))

    def joint_speeds(self) -> list[float]:
        return _listed(np.degrees(self._controller.reading.dq))

    def pose(self, frame: str = "WRF") -> list[float]:
        here = self._controller.planner.pose(self._controller.reading.q)
        return _listed(to_command(np.eye(4) if check_frame(frame) == "TRF" else here))

    def queue(self) -> list[str]:
        return [f"{command.name} {command.text}".strip() for command in self._controller.motion.waiting]

    def status(self) -> dict[str, Any]:
        controller, motion = self._controller, self._controller.motion
        reading, warnings = controller.reading, self._warnings()
        pose, ahead = controller.planner.pose(np.stack([reading.q, reading.q + _AHEAD_S * reading.dq]))
        running, speed_m_s = motion.running, np.linalg.norm(ahead[:3, 3] - pose[:3, 3]) / _AHEAD_S
        pose[:3, 3] *= 1e3
        moves = motion.planned or motion.streams
        return {
            "pose": _listed(pose.reshape(16)),
            "angles": self.angles(),
            "speeds": _listed(reading.dq),
            "torques": _listed(reading.tau_nm),
            "io": [1],  # the e-stop circuit, always closed; there are no digital pins
            "tool": self._tool(),
            "joint_en": _listed(joints_enabled(controller.planner, reading.q)),
            "cart_en": self._open,
            "action_current": running.name if running else "jog" if motion.streams else "",
            "action_params": running.text if running else "",
            "action_state": _ERROR if controller.fault else _EXECUTING if moves else _IDLE,
            "executing_index": running.index if running else -1,
            "completed_index": motion.completed,
            "last_checkpoint": motion.checkpoint,
            "tcp_speed": 1e3 * float(speed_m_s),
            "simulator_active": controller.in_simulator,
            "collision_active": False,
            "collision_pairs": [],
            "scene_epoch": self._settings.scene_epoch,
            "homed": True,  # the motors know their angles without homing
            "enabled": not controller.refusal,
            "warnings": warnings,
            "link_health": {},
            "drive_health": self._drives(),
            "loop_health": self._loop(),
            "homing": {},
            "freedrive": controller.floats,
            "session_id": controller.session_id,
            "error": warnings[0] if controller.fault else None,
        }

    def _tool(self) -> dict[str, Any]:
        controller, reading = self._controller, self._controller.reading
        if controller.tool_key == NO_TOOL or reading.opening is None:
            return {"key": controller.tool_key, "state": _TOOL_OFF, "positions": [], "channels": []}
        position = min(max(swapped(reading.opening), 0.0), 1.0)
        return {
            "key": controller.tool_key,
            "state": _TOOL_IDLE if reading.jaw_still else _TOOL_ACTIVE,
            "engaged": position >= 0.5,
            "part_detected": reading.holds_part,
            "positions": [position],
            "channels": [reading.grip_nm],
        }

    def _warnings(self) -> list[tuple[int, int, str, str, str, str]]:
        """Return (command, code, title, cause, effect, remedy) for each warning. A current fault comes first."""
        controller, found = self._controller, []
        why = controller.fault
        if not why and controller.in_simulator and controller.real is not None and controller.real.armed:
            why = controller.real.trouble()
        if why:
            effect = "the arm takes no commands; its own control loop holds or lands it"
            found.append((-1, _FAULT_CODE, why, why, effect, "look at the arm; then reset, or yam-waldo arm"))
        if controller.stopped:
            found.append((-1, _STOP_CODE, "e-stop latched", "an e-stop was pressed", "the arm holds", "reset (resume)"))
        return found

    def _drives(self) -> dict[str, Any]:
        real = self._controller.real
        if self._controller.in_simulator or real is None:
            return {}
        try:
            state = real.client.published()
        except YamError:
            return {}
        return {
            "temperatures_c": _listed(state.temp_mos_c),
            "currents_ma": None,  # unknown: these motors report torque only
            "bus_voltage_v": None,
            "faults": [
                fault.name for fault in Fault if fault in state.fault and fault not in (Fault.NORMAL, Fault.DISABLED)
            ],
        }

    def _loop(self) -> dict[str, Any]:
        periods = np.diff(self._ticks) if len(self._ticks) > 1 else np.zeros(1)
        return {"p99_period_s": float(np.quantile(periods, 0.99)), "overruns": int((periods > _LATE_S).sum())}


def joints_enabled(planner: Planner, q: np.ndarray) -> np.ndarray:
    """Return 1 for each possible joint jog at q (n,), rad, else 0: (2 n,) int32, joint 1 up, 1 down, joint 2 up …."""
    ways = np.stack([q < planner.upper - _BAND_RAD, q > planner.lower + _BAND_RAD], axis=1)
    return ways.ravel().astype(np.int32)


def axes_enabled(planner: Planner, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return frame -> (12,) int32 for X+ X− Y+ Y− … RZ−: 1 if the tool can move 5 mm or turn 1° from q, else 0."""
    now, found = planner.pose(q), {}
    steps = [sign * _PROBES * axis for axis in np.eye(6) for sign in (1.0, -1.0)]
    for frame in FRAMES:
        ends = [planner.kinematics.follow(commanded(now, step, frame, rel=True), q) for step in steps]
        free = [reached and np.abs(there - q).max() < _JUMP_RAD for there, reached in ends]
        found[frame] = np.array(free, dtype=np.int32)
    return found


def _listed(values: np.ndarray) -> list[Any]:
    listed: list[Any] = values.tolist()
    return listed
