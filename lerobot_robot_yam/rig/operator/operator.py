"""Scripted operator: simulates a person in front of the rig who moves the leader arms. The rig starts this process.

    python -m lerobot_robot_yam.rig.operator.operator --rig NAME --task pick_and_place

The operator moves the leaders only by hand: with limited force, added to the leaders' own gravity compensation. The
operator begins when all arms are energised, stops when an arm is not, and begins again; it ends with the rig.
`pick_and_place` runs endlessly. A task of the scene is attempted repeatedly, each time laid out with the next seed. A
base moves only when a teleoperator reads what the operator asks. With a base there is one attempt in each recorded
episode, from its beginning, and the things are laid out between episodes.
"""

import argparse
import logging
import signal
import sys
import time
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.rig.operator.hands import Interrupted, Sight, pause, sight_of
from lerobot_robot_yam.rig.operator.script import SIDES, Script, sides_of
from lerobot_robot_yam.rig.operator.task_scripts import make_script
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations

logger = logging.getLogger(__name__)

_READY_S = 1.0  # time that a person would wait before gripping the leaders
_POLL_S = 0.1
_VERDICT_S = 2.0  # maximum wait for the verdict, s: a prop must first rest for a while


class RigHands:
    """Hands on a live rig (protocol `hands.Hands`). Raises ConfigError: the scene lacks a leader or a follower."""

    def __init__(self, rig: RigOperations, scene: dict[str, Any]):
        self._rig, self._sides = rig, sides_of(scene)
        self._prop = scene["props"][0]["name"] if scene["props"] else ""
        self.episode: float | None = None  # recorded episode of the attempt, with whose end it ends
        channels = [row["channel"] for row in scene["arms"]]
        needed = [f"{role}_{side}" for role in ("leader", "follower") for side in self._sides or SIDES]
        if missing := [channel for channel in needed if channel not in channels]:
            raise ConfigError(f"scene {scene['name']}: the operator needs the channels {needed}; missing {missing}")

    def now(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    def look(self) -> Sight:
        """Return the sight. Raises Interrupted: the recorded episode of this attempt has ended."""
        if self.episode is not None and _left(self._rig, self.episode):
            self.let_go()
            raise Interrupted
        return sight_of(self._rig.state(brief=True), self._sides)

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        self._rig.hand(f"leader_{side}", times_s.tolist(), q_rad.tolist(), trigger.tolist())

    def drive(self, velocity: np.ndarray) -> None:
        self._rig.ask_drive(velocity.tolist())

    def let_go(self) -> None:
        for side in self._sides:
            self._rig.release(f"leader_{side}")

    def put_back(self, position_m: np.ndarray) -> None:
        self._rig.place(self._prop, position_m.tolist())


def _work(rig: RigControl, script: Script, seed: int) -> int:
    """Perform the script's task once; return the seed for the next attempt."""
    if script.endless:
        script.work()
        return seed
    rig.task(script.setup.task.name, seed)
    script.attempt()
    deadline = time.monotonic() + _VERDICT_S
    state = rig.task_state()
    while not (state["success"] or state["failed"]) and time.monotonic() < deadline:
        time.sleep(_POLL_S)
        state = rig.task_state()
    rig.log("attempt", **{key: state[key] for key in ("task", "seed", "success", "reason", "since_s")})
    return seed + 1


def _left(rig: RigOperations, episode: float) -> bool:
    """Return whether whoever reads what is asked of the base has ended this episode; a reader's pause ends none."""
    reader = rig.drive_reader()
    return bool(reader["reads"] and reader["episode"] != episode)


def _begun(rig: RigControl, last: float | None) -> float | None:
    """Return the episode in which somebody reads what is asked of the base; None if nobody does, or it is `last`."""
    reader = rig.drive_reader()
    episode: float | None = reader["episode"]
    return episode if reader["reads"] and (episode != last or episode == 0.0) else None


def _await_episode(rig: RigControl, script: Script, seed: int, last: float) -> float:
    """Wait for the end of an episode, lay the things out for the next one, wait for that; return its number."""
    while last != 0.0 and not _left(rig, last):
        pause(script.hands, _POLL_S)
    rig.task(script.setup.task.name, seed)
    while (episode := _begun(rig, last)) is None:
        pause(script.hands, _POLL_S)
    return episode


def operate(rig: RigControl, task: str) -> None:
    """Perform the task whenever all arms are energised, and with a base when it is read, until the rig ends.

    Raises:
        ConfigError: the task is unknown, or the scene lacks something that the task needs.
        RigError: the rig has ended.
    """
    scene = rig.scene()
    hands = RigHands(rig, scene)
    script, seed = make_script(hands, scene, task), scene["seed"]
    episode: float | None = None
    while True:
        last, hands.episode = episode, None
        if script.drives:
            rig.task(task, seed)
        ready_since = time.monotonic()
        while time.monotonic() - ready_since < _READY_S:
            time.sleep(_POLL_S)
            episode = _begun(rig, last) if script.drives else None
            if not hands.look().willing or (script.drives and episode is None):
                ready_since = time.monotonic()
        rig.log("operator", did="takes the leaders")
        try:
            hands.episode = episode
            script.begin()
            while True:
                seed = _work(rig, script, seed)
                if episode is not None:
                    hands.episode = None
                    hands.episode = episode = _await_episode(rig, script, seed, episode)
        except Interrupted:
            rig.log("operator", did="lets go")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", required=True, help="name of the running rig")
    parser.add_argument("--task", default="pick_and_place", help="pick_and_place, or a task of the scene")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="operator: %(levelname)s: %(message)s")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    with RigControl(args.rig, hold=False) as rig:
        try:
            operate(rig, args.task)
        except RigError as error:
            logger.info("%s", error)
    return 0


if __name__ == "__main__":
    sys.exit(main())
