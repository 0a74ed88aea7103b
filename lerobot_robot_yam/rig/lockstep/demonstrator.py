"""Scripted operator in lock-step: its hand paths become the followers' targets, on the rig's clock.

    demonstrator = Demonstrator(rig, "lift_and_place", ["left", "right"])
    while not demonstrator.done:
        targets = demonstrator.targets()      # side → joints (n,) and opening, for this instant
        …                                     # send them, let time pass

The operator's script blocks while waiting, so it runs in a second thread. Only one of the two threads runs at a time.
They alternate at times of the rig's clock, so that the result does not depend on the computer.
"""

import threading
from collections.abc import Iterable

import numpy as np

from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.operator.hands import Interrupted, Sight, sight_of
from lerobot_robot_yam.rig.operator.plan import Path
from lerobot_robot_yam.rig.operator.task_scripts import make_script


class Demonstrator:
    """Hands for a task's script (protocol `hands.Hands`); the hand paths become targets.

    rig: rig whose things are already laid out. task: name of a task of the scene. sides: sides that have a follower.

    Attributes:
        velocity: what is asked of the base, (3,), m/s, m/s, rad/s, in its frame; changes with each call of `targets`.

    Raises:
        ConfigError: the task has no script, or the scene lacks something that the script needs.
    """

    def __init__(self, rig: LockstepRig, task: str, sides: Iterable[str]):
        self._rig, self._sides = rig, tuple(sides)
        self._script = make_script(self, rig.scene(), task)
        seen = self.look()
        start = {side: np.append(seen.follower_rad[side], seen.opening[side]) for side in self._sides}
        # side → path of joints and opening, with times on the rig's clock
        self._pulls = {side: Path(np.zeros(1), values[None]) for side, values in start.items()}
        self.velocity = np.zeros(3)
        self._wake_s = rig.now()
        self._script_turn, self._our_turn = threading.Semaphore(0), threading.Semaphore(0)
        self._error: Exception | None = None
        self._over = False
        self.done = False
        self._thread = threading.Thread(target=self._run, name="yam-demonstrator", daemon=True)
        self._thread.start()

    def targets(self) -> dict[str, np.ndarray]:
        """Return each follower's current target, joints and opening (n + 1,); the start until its hand moves.

        Raises:
            YamError: the script failed.
        """
        now = self._rig.now()
        while not self.done and self._wake_s <= now:
            self._script_turn.release()
            self._our_turn.acquire()
            if self._error is not None:
                raise self._error
        return {side: path.at(now) for side, path in self._pulls.items()}

    def close(self) -> None:
        """End the script, whatever its state. Idempotent."""
        self._over = True
        if self._thread.is_alive():
            self._script_turn.release()
            self._thread.join()

    def _run(self) -> None:
        self._script_turn.acquire()
        try:
            if not self._over:
                self._script.begin()
                self._script.attempt()
        except Interrupted:
            pass
        except Exception as error:
            self._error = error
        self.done = True
        self._our_turn.release()

    # methods of the protocol `Hands`, called by the script

    def now(self) -> float:
        return self._rig.now()

    def wait(self, seconds: float) -> None:
        self._wake_s = self._rig.now() + seconds
        self._our_turn.release()
        self._script_turn.acquire()
        if self._over:
            raise Interrupted

    def look(self) -> Sight:
        return sight_of(self._rig.state(brief=True), self._sides)

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        """Move a side's target along joints (k, n) at times from now (k,), with trigger (k,), 0 … 1."""
        path = np.column_stack([q_rad, 1.0 - np.asarray(trigger, float)])
        self._pulls[side] = Path(self._rig.now() + np.asarray(times_s, float), path)

    def drive(self, velocity: np.ndarray) -> None:
        self.velocity = velocity

    def let_go(self) -> None:
        """Do nothing; the targets remain."""

    def put_back(self, position_m: np.ndarray) -> None:
        """Raise Interrupted, because an attempt in which the prop must be put back has failed."""
        raise Interrupted
