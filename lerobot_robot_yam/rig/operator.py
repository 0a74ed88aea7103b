"""The scripted operator: a person in front of the rig who moves the leader arms. The rig starts it.

    python -m lerobot_robot_yam.rig.operator --rig NAME --task pick_and_place

It moves nothing but the leaders, by hand: with limited force, against and with their own gravity compensation. Once
all arms are energised it works until they are not, and waits for the next time; it ends with the rig.
"""

import argparse
import logging
import signal
import sys
import time
from types import FrameType
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.rig.guidance import Interrupted, Sight
from lerobot_robot_yam.rig.pick_and_place import Layout, PickAndPlace
from lerobot_robot_yam.rig.plan import ArmPlanner

logger = logging.getLogger(__name__)

TASKS = ("pick_and_place",)
SIDES = ("left", "right")
_READY_S = 1.0  # a person waits a little before taking hold
_POLL_S = 0.1
_HOME_OUTWARD_M, _HOME_BACK_M, _HOME_HEIGHT_M = 0.19, 0.07, 0.13


class RigHands:
    """Implements `guidance.Hands` on a live rig.

    Args:
        rig: connection to the rig.
        prop: the prop to look at.
    """

    def __init__(self, rig: RigControl, prop: str):
        self._rig = rig
        self._prop = prop

    def now(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    def look(self) -> Sight:
        state = self._rig.state()
        arms, prop = state["arms"], state["props"][self._prop]
        return Sight(
            prop_m=np.array(prop["pos"]),
            prop_quat=np.array(prop["quat"]),
            leader_rad={side: np.array(arms[f"leader_{side}"]["q"]) for side in SIDES},
            follower_rad={side: np.array(arms[f"follower_{side}"]["q"]) for side in SIDES},
            opening={side: float(arms[f"follower_{side}"]["opening"]) for side in SIDES},
            willing=all(_willing(arms[f"{role}_{side}"]) for role in ("leader", "follower") for side in SIDES),
        )

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        self._rig.hand(f"leader_{side}", times_s.tolist(), q_rad.tolist(), trigger.tolist())

    def let_go(self) -> None:
        for side in SIDES:
            self._rig.release(f"leader_{side}")

    def put_back(self, position_m: np.ndarray) -> None:
        self._rig.place(self._prop, position_m.tolist())


def _willing(arm: dict[str, Any]) -> bool:
    return not arm["resists"] and all(motor["enabled"] for motor in arm["motors"].values())


def make_layout(scene: dict[str, Any]) -> Layout:
    """Where things go, from a scene as `RigControl.scene` returns it.

    Raises:
        ConfigError: the scene lacks what the task needs.
    """
    places = {name: (float(point[0]), float(point[1])) for name, point in scene["places"].items()}
    missing = [name for name in ("A", "M", "B") if name not in places]
    if missing or not scene["props"]:
        raise ConfigError(f"scene {scene['name']}: the task needs a prop and the places A, M and B; missing {missing}")
    middle_x, middle_y = places["M"]
    homes = {
        side: (middle_x - _HOME_BACK_M, middle_y + sign * _HOME_OUTWARD_M, _HOME_HEIGHT_M)
        for side, sign in (("left", 1.0), ("right", -1.0))
    }
    return Layout(places, homes, half_m=float(scene["props"][0]["size_m"][2]) / 2)


def make_planners(scene: dict[str, Any]) -> dict[str, ArmPlanner]:
    """One planner per side, for the follower that stands there.

    Raises:
        ConfigError: a side has no follower or no leader.
    """
    arms = {row["channel"]: row for row in scene["arms"]}
    needed = [f"{role}_{side}" for role in ("leader", "follower") for side in SIDES]
    missing = [channel for channel in needed if channel not in arms]
    if missing:
        raise ConfigError(f"scene {scene['name']}: the operator needs the channels {needed}; missing {missing}")
    planners = {}
    for side in SIDES:
        row = arms[f"follower_{side}"]
        model = build_model(row["arm"], row["gripper"], visuals=False)
        planners[side] = ArmPlanner(model, np.array(row["position_m"]), float(row["yaw_rad"]))
    return planners


def operate(rig: RigControl, task: str = TASKS[0]) -> None:
    """Do the task whenever all arms are energised, until the rig ends.

    Raises:
        ConfigError: unknown task, or a scene that lacks what it needs.
        RigError: the rig has ended.
    """
    if task not in TASKS:
        raise ConfigError(f"unknown task '{task}'; known: {', '.join(TASKS)}")
    scene = rig.scene()
    layout, planners = make_layout(scene), make_planners(scene)
    hands = RigHands(rig, scene["props"][0]["name"])
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
            PickAndPlace(hands, planners, layout).run()
        except Interrupted:
            rig.log("operator", did="lets go")


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


def main() -> int:
    """Entry point of the operator's process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", required=True, help="name of the running rig")
    parser.add_argument("--task", default=TASKS[0], choices=TASKS)
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
