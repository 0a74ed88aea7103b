"""Measure inverse kinematics: random poses from anywhere, and smooth paths with one call per pose.

    python scripts/bench_ik.py --json outputs/bench_ik.json

Takes about two minutes; `--quick` a short look. placo, LeRobot's solver, is measured beside ours where it is installed
(`pip install "placo<0.9.16" "cmeel-urdfdom<5" "cmeel-tinyxml2<11"`). Solved means within 1e-4 m and 1e-3 rad. Times
are of one call: `wall` is only worth something on a machine that does nothing else, `cpu` is the thread's own. Random
poses have 100 ms of cpu time, so that neighbours do not decide.
"""

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from bench.placo import PlacoArm
from tqdm import tqdm

from lerobot_robot_yam.arm.kinematics import PoseTracker, YamKinematics
from lerobot_robot_yam.arm.profile_files import ARMS

GRIPPER = "linear_4310"
BUDGET_S, CLOCK_S = 0.1, 1.0
RATE_HZ, SPEED_RAD_S = 30, 1.5


class Subject(Protocol):
    """A solver for one arm."""

    def find(self, target: np.ndarray, budget_s: float) -> tuple[bool, int]:
        """Whether a pose was found from nowhere within the time, and how many starts it took."""

    def begin(self, q: np.ndarray) -> None:
        """A path begins at `q` (6,)."""

    def follow(self, target: np.ndarray) -> bool:
        """Whether the path's next pose was found, in one call."""


class OurArm:
    """`YamKinematics` and `PoseTracker`."""

    def __init__(self, arm: str, gripper: str):
        self._kinematics = YamKinematics(arm, gripper)
        self._tracker = PoseTracker(self._kinematics, self._kinematics.middle)

    def find(self, target: np.ndarray, budget_s: float) -> tuple[bool, int]:
        """See `Subject`."""
        result = self._kinematics.ik(target, budget_s=budget_s)
        return result.converged, result.attempts

    def begin(self, q: np.ndarray) -> None:
        """See `Subject`."""
        self._tracker.restart(q)

    def follow(self, target: np.ndarray) -> bool:
        """See `Subject`."""
        return self._tracker.solve(target).converged


SUBJECTS: dict[str, Callable[[str, str], Subject]] = {
    "ours": OurArm,
    "placo": PlacoArm,
    "placo_one_step": lambda arm, gripper: PlacoArm(arm, gripper, steps=1),
}


def joint_path(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(k, 6) minimum jerk between two joint vectors at a follower's speed, at LeRobot's rate."""
    count = max(int(1.875 * np.abs(end - start).max() / SPEED_RAD_S * RATE_HZ), 2)
    s = np.linspace(0.0, 1.0, count)
    return start + np.outer(s**3 * (10 - 15 * s + 6 * s**2), end - start)


class Calls:
    """The calls of one measurement: whether they solved it, and how long they took."""

    def __init__(self) -> None:
        self._solved: list[bool] = []
        self._seconds: dict[str, list[float]] = {"wall": [], "cpu": []}

    def time[**P, T](self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call, and note the time."""
        wall_s, cpu_s = time.perf_counter(), time.thread_time()
        result = call(*args, **kwargs)
        self._seconds["wall"].append(time.perf_counter() - wall_s)
        self._seconds["cpu"].append(time.thread_time() - cpu_s)
        return result

    def note(self, solved: bool) -> None:
        """What the call just timed has come to; too late is not solved."""
        self._solved.append(solved and self._seconds["cpu"][-1] <= BUDGET_S)

    def figures(self) -> dict[str, float]:
        """Share solved, and times in ms."""
        found = {"solved": float(np.mean(self._solved)), "count": len(self._solved)}
        for clock, seconds in self._seconds.items():
            for name, percentile in (("p50", 50), ("p99", 99), ("max", 100)):
                found[f"{clock}_{name}_ms"] = float(np.percentile(seconds, percentile) * 1e3)
        return found


def measure_random(subject: Subject, arm: YamKinematics, count: int) -> dict[str, float]:
    """Random reachable poses, from nowhere."""
    calls, starts = Calls(), []
    for q in np.random.default_rng(4).uniform(arm.lower, arm.upper, size=(count, 6)):
        solved, attempts = calls.time(subject.find, arm.fk(q), CLOCK_S)
        calls.note(solved)
        starts.append(attempts)
    return calls.figures() | {"starts": float(np.mean(starts))}


def measure_paths(subject: Subject, arm: YamKinematics, count: int) -> dict[str, float]:
    """Smooth paths between random joint vectors, one call per pose."""
    calls = Calls()
    for start, end in np.random.default_rng(7).uniform(arm.lower, arm.upper, size=(count, 2, 6)):
        subject.begin(start)
        for q in joint_path(start, end):
            calls.note(calls.time(subject.follow, arm.fk(q)))
    return calls.figures()


def table(results: dict[str, dict[str, Any]]) -> str:
    """The figures as text."""
    times = [f"{clock}_{name}_ms" for clock in ("wall", "cpu") for name in ("p50", "p99", "max")]
    heads = "".join(f"{name.removesuffix('_ms').replace('_', ' '):>10}" for name in times)
    lines = [f"{'solver':15} {'arm':10} {'poses':8} {'solved':>9}{heads}   (times in ms)"]
    for name, arms in results.items():
        if isinstance(arms, str):
            lines.append(f"{name:15} {arms}")
            continue
        for arm, kinds in arms.items():
            for kind, row in kinds.items():
                values = "".join(f"{row[key]:10.2f}" for key in times)
                lines.append(f"{name:15} {arm:10} {kind:8} {row['solved']:9.3%}{values}")
    return "\n".join(lines)


def main(args: argparse.Namespace) -> int:
    """Measure, print, write."""
    poses, paths = (50, 5) if args.quick else (1000, 60)
    results: dict[str, Any] = {}
    with tqdm([(name, arm) for name in args.only for arm in args.arms], file=sys.stderr, unit="arm") as progress:
        for name, arm in progress:
            progress.set_postfix_str(f"{name} {arm}")
            if isinstance(results.get(name), str):
                continue
            try:
                subject = SUBJECTS[name](arm, GRIPPER)
            except ImportError as error:
                results[name] = f"not measured: {error}"
                continue
            kinematics, found = YamKinematics(arm, GRIPPER), {}
            if name != "placo_one_step":
                found["random"] = measure_random(subject, kinematics, poses)
            found["path"] = measure_paths(subject, kinematics, paths)
            results.setdefault(name, {})[arm] = found
    print(table(results))
    machine = {"cores": os.cpu_count(), "machine": platform.machine(), "load": os.getloadavg()}
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps({**results, "budget_s": BUDGET_S, "machine": machine}, indent=1))
        print(f"figures: {args.json}")
    return 0


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the results to this file")
    parser.add_argument("--quick", action="store_true", help="a short look")
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    parser.add_argument("--only", nargs="+", choices=list(SUBJECTS), default=list(SUBJECTS))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main(arguments()))
