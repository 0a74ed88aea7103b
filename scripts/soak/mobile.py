"""Soak of a mobile robot in lock-step: two arms and a base under random targets, faults, stalls and stops.

Time is simulated, so the same seed gives the same run on any machine. A simulated person waits for the faults to end,
then re-arms or reconnects. What is true of the world and what the states say are compared at each step of the caller.
"""

import contextlib
import logging
import math
import random
import sys
from collections import Counter, deque
from typing import Any

import numpy as np
from tqdm import tqdm

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.base_profile import FLIP_RAD_S, HARD_CAP_ACCELERATION
from lerobot_robot_yam.mobile.odometry import to_body
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import RESPONSES, Response, Trouble
from lerobot_robot_yam.state.modes import Mode
from soak.injected_faults import FOLLOWERS, LEADERS, RANDOM
from soak.schedule import Injection, make_schedule

logger = logging.getLogger("soak")

BASE, STEP_S = "base", 0.05
KINDS = [name for name, kind in RANDOM.items() if kind.rig and name != "handle_silent"]
KINDS += ["caller_stall", "emergency_stop"]
_WAIT_S = 2.0  # after the last fault has ended, s, before the person acts
_REST_S = 4.5  # by then a base that brakes from any speed is at rest, s
_REST_M_S, _REST_RAD_S = 0.02, 0.05
_EXPLAINS_S = 2.0  # time after its end in which a fault explains a trouble, s
_SINKS_M = 0.02  # maximum change of height of the tool of an arm that holds, m
_HALF_ROOM_M = 0.25  # the base is sent back when it is farther from its start, m: tables stand around it
_STOPS_RAD = [3.25, -3.3]


class MobileSoak:
    """One run.

    Args:
        minutes: simulated duration.
        seed, pace: see `make_schedule`.
    """

    def __init__(self, minutes: float, seed: int, pace: float = 1.0):
        self._rig = LockstepRig("mobile_tables", arms=list(FOLLOWERS), seed=seed)
        self._chance = random.Random(f"{seed} caller")
        self._end_s = minutes * 60.0
        self._schedule = deque(make_schedule(self._end_s, seed, pace, KINDS))
        self._begin_s = self._rig.now()
        self._open: list[tuple[float, Injection]] = []  # end of each fault that lasts, and the fault
        self._recent: deque[tuple[float, Injection]] = deque(maxlen=200)
        self.counts: Counter[str] = Counter()
        self.injected: Counter[str] = Counter()
        self.violations: list[dict[str, Any]] = []
        self._stall_s = self._stop_s = 0.0
        self._session: ArmSession | None = None
        self._targets: dict[str, np.ndarray] = {}
        self._twist: np.ndarray = np.zeros(3)
        self._since: dict[str, tuple[Mode, float, float]] = {}  # mode of each part, since when, tool's height then
        self._planned: tuple[int, np.ndarray] | None = None

    @property
    def now(self) -> float:
        """Simulated time since the start, s."""
        return self._rig.now() - self._begin_s

    def run(self) -> None:
        """Run to the end; close the rig."""
        try:
            with tqdm(total=round(self._end_s), unit="s", file=sys.stderr, mininterval=1.0) as progress:
                while self.now < self._end_s:
                    self._inject()
                    if self._session is None:
                        self._connect()
                    self._command()
                    self._rig_or_session_sleep(STEP_S)
                    self._judge()
                    self._person()
                    progress.update(int(self.now) - progress.n)
            self._leave()
        finally:
            EmergencyStop().release()
            self._rig.close()

    def _rig_or_session_sleep(self, seconds: float) -> None:
        clock = self._rig if self._session is None else self._session.clock
        clock.sleep(seconds)

    def _connect(self) -> None:
        if self._open or self.now < self._stop_s:
            return
        own = {"interface": "yam_lockstep", "can_options": {"rig": self._rig.name}}
        arms = [ArmConfig(name=one, channel=one, gripper_stops_rad=_STOPS_RAD, **own) for one in FOLLOWERS]
        session = ArmSession([*arms, BaseConfig(channel=BASE, **own)], "lockstep")
        try:
            session.start()
        except YamError as error:
            self.counts["start refused"] += 1
            logger.info("start refused: %s", error)
            return
        self._session, self._since, self._planned = session, {}, None
        self.counts["connected"] += 1

    def _leave(self) -> None:
        session, self._session = self._session, None
        if session is None:
            return
        if not session.stop():
            self._violate("lands", "", "session.stop() says that a part does not land")
        if any(motor["enabled"] for motor in self._rig.state()[BASE]["motors"].values()):
            self._violate("off at the end", BASE, "a motor of the base is still enabled")
        before = self._base_pose()
        self._rig.sleep(0.5)
        if np.hypot(*(self._base_pose() - before)[:2]) > 0.5 * _REST_M_S:
            self._violate("off at the end", BASE, "the base rolls after the end of the session")

    # faults

    def _inject(self) -> None:
        for end_s, row in [pair for pair in self._open if pair[0] <= self.now]:
            self._open.remove((end_s, row))
            kind = RANDOM[row.kind]
            self._rig.fault(*_place(row), kind.rig, kind.usual)
            self._recent.append((self.now, row))
        while self._schedule and self._schedule[0].at_s <= self.now:
            row = self._schedule.popleft()
            if self._session is None:
                continue
            self.injected[row.kind] += 1
            if row.kind == "caller_stall":
                self._stall_s = self.now + row.seconds
            elif row.kind == "emergency_stop":
                EmergencyStop().latch("the soak")
                self._stop_s = self.now + row.seconds
            else:
                self._rig.fault(*_place(row), RANDOM[row.kind].rig, _value(row), **RANDOM[row.kind].details)
                if row.seconds:
                    self._open.append((self.now + row.seconds, row))
            self._recent.append((self.now, row))
        if self._stop_s and self.now >= self._stop_s:
            EmergencyStop().release()
            self._stop_s = 0.0

    # caller

    def _command(self) -> None:
        session = self._session
        if session is None or self.now < self._stall_s:
            return
        for name in FOLLOWERS:
            if name not in self._targets or self._chance.random() < 0.02:
                self._targets[name] = np.array(
                    [self._chance.uniform(-0.3, 0.3) + at for at in (0, 1.1, 1.1, -0.2, 0, 0)]
                )
            with contextlib.suppress(YamError):
                session[name].write_target(self._targets[name], self._chance.random())
        if self._chance.random() < 0.03:
            self._twist = np.array([self._chance.uniform(-most, most) for most in (0.5, 0.5, 1.57)])
        pose = self._base_pose()
        if np.hypot(*(pose[:2] - self._start[:2])) > _HALF_ROOM_M:
            away = np.array([*(self._start[:2] - pose[:2]), 0.0])
            self._twist = np.array([*to_body(away, float(pose[2]))[:2], self._twist[2]])
        with contextlib.suppress(YamError):
            session.base(BASE).write_velocity(self._twist)

    @property
    def _start(self) -> np.ndarray:
        return np.array([*self._rig.device.scene.base.position_m, 0.0])  # type: ignore[union-attr]

    def _base_pose(self) -> np.ndarray:
        return np.array(self._rig.state()[BASE]["pose"])

    # person

    def _person(self) -> None:
        session = self._session
        if session is None or self._open or self.now < max(self._stop_s, self._stall_s):
            return
        in_trouble = [
            name for name in (*FOLLOWERS, BASE) if self._state(name).mode in (Mode.FAULT, Mode.LAND, Mode.OFF)
        ]
        newest_s = max((at_s for at_s, _ in self._recent), default=0.0)
        if not in_trouble or self.now < newest_s + _WAIT_S:
            return
        try:
            session.rearm()
            self.counts["re-armed"] += 1
        except YamError as error:
            logger.info("re-arming refused: %s", error)
            self.counts["reconnected"] += 1
            self._leave()

    # judge

    def _state(self, name: str) -> Any:
        assert self._session is not None
        return self._session.base(name).published() if name == BASE else self._session[name].published()

    def _judge(self) -> None:
        session = self._session
        if session is None:
            return
        world = self._rig.state()
        for name in (*FOLLOWERS, BASE):
            state = self._state(name)
            height = 0.0 if name == BASE else float(world["arms"][name]["tcp_site"]["pos"][2])
            mode, since_s, begin = self._since.get(name, (None, 0.0, 0.0))
            if state.mode is not mode:
                since_s, begin = self.now, height
                self._since[name] = (state.mode, self.now, height)
            self._judge_trouble(name, state)
            if name != BASE and state.trouble is None and state.mode in (Mode.HOLD, Mode.STOPPED):
                if self.now - since_s > 1.0 and begin - height > _SINKS_M and not self._cut(name):
                    self._violate("holds", name, f"the tool has sunk by {(begin - height) * 1e3:.0f} mm")
            if name == BASE:
                self._judge_base(state, self.now - since_s)

    def _judge_trouble(self, name: str, state: Any) -> None:
        if state.trouble is None:
            return
        rows = [row for at_s, row in self._recent if self.now - at_s < _EXPLAINS_S] + [row for _, row in self._open]
        if not any(_place(row)[0] == name and state.trouble in RANDOM[row.kind].troubles for row in rows):
            mode, since_s, _ = self._since[name]
            if self.now - since_s < STEP_S:
                self._violate("trouble has a cause", name, f"{state.trouble}: {state.message}")
        if state.trouble is Trouble.INTERNAL_ERROR:
            self._violate("no internal error", name, state.message)

    def _judge_base(self, state: Any, for_s: float) -> None:
        if self._planned is not None:
            ticks, before = state.tick - self._planned[0], self._planned[1]
            most = np.array(HARD_CAP_ACCELERATION) * 0.012 * max(ticks, 1) + 1e-6  # the loop's longest step
            usual = np.array(HARD_CAP_ACCELERATION) * (STEP_S + 0.03)
            if (np.abs(state.planned - before) > np.minimum(most, usual)).any():
                self._violate("acceleration", BASE, f"planned {before} then {state.planned}")
        self._planned = (state.tick, state.planned)
        lies = any(_place(row)[0] == BASE for _, row in self._open)
        if not lies and np.abs(state.steer_rad_s).max() > 1.3 * FLIP_RAD_S and state.trouble is None:
            self._violate("no flip", BASE, f"steering at {state.steer_rad_s}")
        lost = state.trouble is not None and RESPONSES[state.trouble].arm is Response.LOST
        if state.mode in (Mode.FAULT, Mode.STOPPED, Mode.HOLD) and for_s > _REST_S and not lost and not self._cut(BASE):
            before = self._base_pose()
            self._rig_or_session_sleep(STEP_S)
            moved = (self._base_pose() - before) / STEP_S
            if np.hypot(*moved[:2]) > _REST_M_S or abs(math.remainder(moved[2], math.tau)) > _REST_RAD_S:
                self._violate("stands", BASE, f"moves by {moved} in mode {state.mode.name}")

    def _cut(self, name: str) -> bool:
        """Return whether a fault keeps commands from the part, or did in the last seconds."""
        rows = [row for at_s, row in self._recent if self.now - at_s < _REST_S] + [row for _, row in self._open]
        return any(_place(row)[0] == name and (RANDOM[row.kind].cuts or row.kind == "motor_fault") for row in rows)

    def _violate(self, invariant: str, channel: str, what: str) -> None:
        row = {"violation": invariant, "at_s": self.now, "channel": channel, "what": what}
        self.violations.append(row | {"after_injection": sum(self.injected.values())})
        logger.error("VIOLATION %s", row)


def _place(row: Injection) -> tuple[str, str | None]:
    """Return channel and motor of a fault; what the schedule gives the leaders goes to the base."""
    if row.channel not in LEADERS:
        return row.channel, row.motor or None
    number = 7 if row.motor == "gripper" else int(row.motor[-1] or 1) if row.motor else None
    return BASE, number


def _value(row: Injection) -> Any:
    return True if row.value is None else row.value


def soak_mobile(minutes: float, seed: int, pace: float) -> dict[str, Any]:
    """Run the soak; return the report."""
    run = MobileSoak(minutes, seed, pace)
    run.run()
    return {
        "minutes": minutes,
        "seed": seed,
        "pace": pace,
        "injected": dict(run.injected),
        "judge": {},
        "caller": {"counts": dict(run.counts), "errors": {}, "oldest_state_s": 0.0},
        "log": [],
        "violations": run.violations,
    }
