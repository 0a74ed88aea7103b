"""Soak of a mobile robot in lock-step: two arms, base and rail under random targets, faults, stalls and stops.

Time is simulated, so the same seed gives the same run on any machine. A simulated person waits for the faults to end,
then re-arms or reconnects. `mobile_judge` compares the world with the states at each step of the caller.
"""

import contextlib
import logging
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.odometry import to_body
from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Mode
from soak.injected_faults import FOLLOWERS
from soak.mobile_faults import BASE, MobileFaults
from soak.mobile_judge import REST_M_S, STEP_S, MobileJudge

logger = logging.getLogger("soak")

_WAIT_S = 2.0  # after the last fault has ended, s, before the person acts
_HALF_ROOM_M = 0.25  # the base is sent back when it is farther from its start, m: tables stand around it
_STOPS_RAD = [3.25, -3.3]  # of the grippers in the scene, so that no search is needed
_MIDDLE = np.array([0.0, 1.1, 1.1, -0.2, 0.0, 0.0])  # pose around which the arms move, rad


class MobileSoak:
    """One run.

    Args:
        minutes: simulated duration.
        seed, pace: see `make_schedule`.
        folder: where the rail's calibration is kept.
    """

    def __init__(self, minutes: float, seed: int, pace: float, folder: Path):
        self._rig = LockstepRig("mobile_tables", arms=list(FOLLOWERS), seed=seed, rail=True)
        self._chance, self._calibration = random.Random(f"{seed} caller"), folder / "rail.json"
        self._begin_s, self._end_s = self._rig.now(), minutes * 60.0
        self.faults = MobileFaults(self._rig, self._end_s, seed, pace)
        self._judge = MobileJudge(self.faults, self._violate)
        self.counts: Counter[str] = Counter()
        self.violations: list[dict[str, Any]] = []
        self._session: ArmSession | None = None
        self._targets: dict[str, np.ndarray] = {}
        self._twist, self._lift, self._slips = np.zeros(3), 0.0, 0
        self._start_m = np.array(self._world()[BASE]["pose"][:2])

    @property
    def now(self) -> float:
        """Simulated time since the start, s."""
        return self._rig.now() - self._begin_s

    def _world(self) -> dict[str, Any]:
        return self._rig.state()

    def run(self) -> None:
        """Run to the end; close the rig."""
        try:
            with tqdm(total=round(self._end_s), unit="s", file=sys.stderr, mininterval=1.0) as progress:
                while self.now < self._end_s:
                    self._step()
                    progress.update(int(self.now) - progress.n)
            self.faults.end()
            if self._session is not None:
                self._session.clock.sleep(_WAIT_S)
                self._leave()
        finally:
            self.faults.end()
            self._rig.close()

    def _step(self) -> None:
        self.faults.advance(self.now, self._session is not None)
        if self._session is None and not self.faults.pending(self.now):
            self.faults.clear()  # replies still to be lost or falsified would hit the start, which refuses such a motor
            self._connect()
        session = self._session
        if session is None:
            self._rig.sleep(STEP_S)
            return
        if self.now >= self.faults.stall_s:
            self._command(session)
        session.clock.sleep(STEP_S)
        states = {name: session[name].published() for name in FOLLOWERS} | {BASE: session.base(BASE).published()}
        self._judge.look(self.now, self._world(), states)
        if any(state.mode in (Mode.FAULT, Mode.LAND, Mode.OFF) for state in states.values()):
            self._repair(session)

    def _connect(self) -> None:
        place: dict[str, Any] = {"interface": "yam_lockstep", "can_options": {"rig": self._rig.name}}
        arms = [ArmConfig(name=one, channel=one, gripper_stops_rad=_STOPS_RAD, **place) for one in FOLLOWERS]
        rail = RailConfig(io="sim", calibration_path=str(self._calibration))
        session = ArmSession([*arms, BaseConfig(channel=BASE, rail=rail, **place)], "lockstep")
        try:
            session.start()
        except YamError as error:
            self._violate("connects", "", str(error))
            return
        self.counts["connected"] += 1
        self._slips = self.faults.injected["rail brake_slips"]
        self._session = session
        self._judge.forget()
        self._home(session)

    def _home(self, session: ArmSession) -> None:
        """Home the rail unless its height is known."""
        rail = session.base(BASE).published().rail
        if rail is not None and not rail.homed:
            try:
                session.base(BASE).home_rail()
                self.counts["homed"] += 1
            except YamError as error:
                self._violate("homes", BASE, str(error))

    def _command(self, session: ArmSession) -> None:
        """Write random targets."""
        chance = self._chance
        for name in FOLLOWERS:
            if name not in self._targets or chance.random() < 0.02:
                self._targets[name] = _MIDDLE + np.array([chance.uniform(-0.3, 0.3) for _ in _MIDDLE])
            with contextlib.suppress(YamError):
                session[name].write_target(self._targets[name], chance.random())
        if chance.random() < 0.03:
            self._twist = np.array([chance.uniform(-most, most) for most in (0.5, 0.5, 1.57)])
            self._lift = chance.uniform(-0.4, 0.4)
        x, y, heading = self._world()[BASE]["pose"]
        back = self._start_m - (x, y)
        if np.hypot(*back) > _HALF_ROOM_M:
            self._twist[:2] = to_body(np.array([*back, 0.0]), heading)[:2]
        with contextlib.suppress(YamError):
            session.base(BASE).write_velocity(self._twist)
            session.base(BASE).write_rail_velocity(self._lift)

    def _repair(self, session: ArmSession) -> None:
        """Re-arm or reconnect once the faults have ended."""
        if self.faults.pending(self.now) or self.now < self.faults.newest_s + _WAIT_S:
            return
        try:
            session.rearm()
            self.counts["re-armed"] += 1
            self._home(session)
        except YamError as error:
            logger.info("re-arming refused: %s", error)
            self.counts["reconnected"] += 1
            self._leave()

    def _leave(self) -> None:
        session, self._session = self._session, None
        assert session is not None
        landed = session.stop()
        arms_off = not any(m["enabled"] for one in FOLLOWERS for m in self._world()["arms"][one]["motors"].values())
        if not landed and arms_off and self.faults.injected["rail brake_slips"] > self._slips:
            self.counts["power cut, as the brake had slipped"] += 1  # the motor holds until a person does this
            self._rig.fault(BASE, None, "power", False)
            self._rig.fault(BASE, None, "power", True)
        elif not landed:
            self._violate("lands", "", "session.stop() says that a part does not land")
        before = self._world()[BASE]
        if any(motor["enabled"] for motor in before["motors"].values()):
            self._violate("off at the end", BASE, "a motor is still enabled")
        self._rig.sleep(0.5)
        after = self._world()[BASE]
        rolled_m = float(np.hypot(*(np.array(after["pose"]) - before["pose"])[:2]))
        fallen_m = before["rail"]["height"] - after["rail"]["height"]
        if rolled_m > 0.5 * REST_M_S or fallen_m > 0.005:
            self._violate("off at the end", BASE, f"it rolls by {rolled_m:.3f} m, the rail falls by {fallen_m:.3f} m")

    def _violate(self, invariant: str, channel: str, what: str) -> None:
        row = {"violation": invariant, "at_s": self.now, "channel": channel, "what": what}
        self.violations.append(row | {"after_injection": self.faults.injected.total()})
        logger.error("VIOLATION %s", row)


def soak_mobile(minutes: float, seed: int, pace: float) -> dict[str, Any]:
    """Run the soak; return the report."""
    with tempfile.TemporaryDirectory() as folder:
        run = MobileSoak(minutes, seed, pace, Path(folder))
        run.run()
    return {
        "minutes": minutes,
        "seed": seed,
        "pace": pace,
        "injected": dict(run.faults.injected),
        "judge": {},
        "caller": {"counts": dict(run.counts), "errors": {}, "oldest_state_s": 0.0},
        "log": [],
        "violations": run.violations,
    }
