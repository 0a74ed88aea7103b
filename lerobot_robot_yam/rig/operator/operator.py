"""The scripted operator: a person in front of the rig who moves the leader arms. The rig starts it.

    python -m lerobot_robot_yam.rig.operator.operator --rig NAME --task pick_and_place

It moves nothing but the leaders, by hand: with limited force, against and with their own gravity compensation. Once
all arms are energised it works until they are not, and waits for the next time; it ends with the rig. `pick_and_place`
goes on for ever; a task of the scene is attempted again and again, each time strewn by the next seed.
"""

import argparse
import logging
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.client.rig_control import RigControl
from lerobot_robot_yam.rig.operator.guidance import Interrupted
from lerobot_robot_yam.rig.operator.pick_and_place import Layout, PickAndPlace
from lerobot_robot_yam.rig.operator.scripts.catalog import make_script
from lerobot_robot_yam.rig.operator.scripts.script import Script
from lerobot_robot_yam.rig.operator.scripts.setup import SIDES, make_planners, sides_of
from lerobot_robot_yam.rig.operator.sight import Sight, sight_of

logger = logging.getLogger(__name__)

PICK_AND_PLACE = "pick_and_place"
_READY_S = 1.0  # a person waits a little before taking hold
_POLL_S = 0.1
_VERDICT_S = 2.0  # the judge sees a prop rest for a while before it says so
_HOME_OUTWARD_M, _HOME_BACK_M, _HOME_HEIGHT_M = 0.19, 0.07, 0.13


class RigHands:
    """Implements `guidance.Hands` on a live rig.

    Args:
        rig: connection to the rig.
        sides: those that have a leader and a follower.
        prop: what `put_back` puts back.
    """

    def __init__(self, rig: RigControl, sides: Sequence[str], prop: str = ""):
        self._rig = rig
        self._sides = tuple(sides)
        self._prop = prop

    def now(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    def look(self) -> Sight:
        return sight_of(self._rig.state(), self._sides)

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        self._rig.hand(f"leader_{side}", times_s.tolist(), q_rad.tolist(), trigger.tolist())

    def let_go(self) -> None:
        for side in self._sides:
            self._rig.release(f"leader_{side}")

    def put_back(self, position_m: np.ndarray) -> None:
        self._rig.place(self._prop, position_m.tolist())


class Attempts:
    """Attempts at a task, one after the other.

    Args:
        rig: the rig, which places and judges.
        hands: the operator's.
        script: does the task.
        seed: of the first attempt; the next ones have the next numbers.
    """

    def __init__(self, rig: RigControl, hands: RigHands, script: Script, seed: int):
        self._rig, self._hands, self._script, self._seed = rig, hands, script, seed

    def run(self) -> None:
        """Take the leaders to their waiting poses, then attempt the task for ever.

        Raises:
            Interrupted: the arms were switched off. The hands have let go; what was under way will be begun anew.
        """
        name = self._script.setup.task.name
        try:
            self._script.begin()
            while True:
                self._rig.task(name, self._seed)
                self._script.attempt()
                state = self._verdict()
                told = {key: state[key] for key in ("task", "seed", "success", "reason", "since_s")}
                self._rig.log("attempt", **told)
                self._seed += 1
        finally:
            self._hands.let_go()

    def _verdict(self) -> dict[str, Any]:
        deadline = time.monotonic() + _VERDICT_S
        while True:
            state = self._rig.task_state()
            if state["success"] or state["failed"] or time.monotonic() > deadline:
                return state
            self._hands.wait(_POLL_S)


def make_layout(scene: dict[str, Any]) -> Layout:
    """Where things go in `PickAndPlace`, from a scene as `RigControl.scene` returns it.

    Raises:
        ConfigError: the scene lacks what it needs.
    """
    places = {name: (float(point[0]), float(point[1])) for name, point in scene["places"].items()}
    missing = [name for name in ("A", "M", "B") if name not in places]
    if missing or not scene["props"] or scene["props"][0]["size_m"] is None:
        raise ConfigError(
            f"scene {scene['name']}: {PICK_AND_PLACE} needs a prop with a size_m, and the places A, M and B; "
            f"missing {missing}"
        )
    middle_x, middle_y = places["M"]
    homes = {
        side: (middle_x - _HOME_BACK_M, middle_y + sign * _HOME_OUTWARD_M, _HOME_HEIGHT_M)
        for side, sign in (("left", 1.0), ("right", -1.0))
    }
    prop = scene["props"][0]
    return Layout(prop["name"], places, homes, half_m=float(prop["size_m"][2]) / 2)


def check_arms(scene: dict[str, Any], sides: Sequence[str]) -> None:
    """There are hands to guide.

    Raises:
        ConfigError: a side has no follower or no leader, or there are no sides.
    """
    channels = [row["channel"] for row in scene["arms"]]
    needed = [f"{role}_{side}" for role in ("leader", "follower") for side in sides or SIDES]
    missing = [channel for channel in needed if channel not in channels]
    if missing:
        raise ConfigError(f"scene {scene['name']}: the operator needs the channels {needed}; missing {missing}")


def operate(rig: RigControl, task: str = PICK_AND_PLACE) -> None:
    """Do the task whenever all arms are energised, until the rig ends.

    Raises:
        ConfigError: unknown task, or a scene that lacks what it needs.
        RigError: the rig has ended.
    """
    scene = rig.scene()
    run: Callable[[], None]
    if task == PICK_AND_PLACE:
        check_arms(scene, SIDES)
        layout, planners = make_layout(scene), make_planners(scene)
        hands = RigHands(rig, SIDES, layout.prop)

        def run() -> None:
            PickAndPlace(hands, planners, layout).run()
    else:
        sides = sides_of(scene)
        check_arms(scene, sides)
        hands = RigHands(rig, sides)
        run = Attempts(rig, hands, make_script(hands, scene, task), scene["seed"]).run
    while True:
        ready_since = None
        while ready_since is None or time.monotonic() - ready_since < _READY_S:
            time.sleep(_POLL_S)
            if not hands.look().willing:
                ready_since = None
            elif ready_since is None:
                ready_since = time.monotonic()
        rig.log("operator", did="takes the leaders")
        try:
            run()
        except Interrupted:
            rig.log("operator", did="lets go")


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


def main() -> int:
    """Entry point of the operator's process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", required=True, help="name of the running rig")
    parser.add_argument("--task", default=PICK_AND_PLACE, help=f"{PICK_AND_PLACE}, or a task of the scene")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="operator: %(levelname)s: %(message)s")
    signal.signal(signal.SIGTERM, _end)
    with RigControl(args.rig, hold=False) as rig:
        try:
            operate(rig, args.task)
        except RigError as error:
            logger.info("%s", error)
    return 0


if __name__ == "__main__":
    sys.exit(main())
