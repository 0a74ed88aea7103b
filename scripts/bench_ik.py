"""Measure inverse kinematics: random poses without a start pose, and smooth paths with one call per pose.

    python scripts/bench_ik.py --json outputs/bench_ik.json

Takes about a minute; `--quick` measures fewer poses. A pose counts as solved within 1e-4 m and 1e-3 rad, and within
100 ms of the thread's CPU time, so that other processes do not affect the result. Times are per call.
"""

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import ARMS
from lerobot_robot_yam.arm.kinematics import PoseTracker, YamKinematics

GRIPPER = "linear_4310"
BUDGET_S = 0.1  # maximum CPU time for a pose to count as solved
CLOCK_S = 1.0  # time after which the solver gives up
RATE_HZ, SPEED_RAD_S = 30, 1.5  # poses per second of a path, and speed of its fastest joint


def joint_path(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return a minimum-jerk path (k, 6) between two joint vectors at a follower's speed and LeRobot's rate."""
    count = max(int(1.875 * np.abs(end - start).max() / SPEED_RAD_S * RATE_HZ), 2)
    s = np.linspace(0.0, 1.0, count)
    return start + np.outer(s**3 * (10 - 15 * s + 6 * s**2), end - start)


class Calls:
    """Calls of one measurement: success and CPU time, s, of each."""

    def __init__(self) -> None:
        self._solved: list[bool] = []
        self._seconds: list[float] = []

    def time(self, solve: Callable[[], bool]) -> None:
        """Call `solve` and record success and time; a solution that exceeds the budget counts as failed."""
        begin = time.thread_time()
        solved = solve()
        self._seconds.append(time.thread_time() - begin)
        self._solved.append(solved and self._seconds[-1] <= BUDGET_S)

    def figures(self) -> dict[str, float]:
        """Return the fraction solved, and times in ms."""
        times = {f"p{share}_ms": float(np.percentile(self._seconds, share) * 1e3) for share in (50, 99, 100)}
        return {"solved": float(np.mean(self._solved)), "count": len(self._solved)} | times


def measure_random(arm: YamKinematics, count: int) -> dict[str, float]:
    """Measure random reachable poses without a start pose."""
    calls = Calls()
    for q in np.random.default_rng(4).uniform(arm.lower, arm.upper, size=(count, 6)):
        target = arm.fk(q)
        calls.time(lambda target=target: arm.ik(target, budget_s=CLOCK_S).converged)
    return calls.figures()


def measure_paths(arm: YamKinematics, count: int) -> dict[str, float]:
    """Measure smooth paths between random joint vectors, with one call per pose."""
    calls, tracker = Calls(), PoseTracker(arm, arm.middle)
    for start, end in np.random.default_rng(7).uniform(arm.lower, arm.upper, size=(count, 2, 6)):
        tracker.restart(start)
        for q in joint_path(start, end):
            target = arm.fk(q)
            calls.time(lambda target=target: tracker.solve(target).converged)
    return calls.figures()


def main(args: argparse.Namespace) -> int:
    """Measure, print the table, and write the results."""
    poses, paths = (50, 5) if args.quick else (1000, 60)
    results: dict[str, Any] = {}
    print(f"{'arm':12} {'poses':8} {'solved':>9} {'p50':>9} {'p99':>9} {'max':>9}   (cpu ms per call)")
    for name in args.arms:
        arm = YamKinematics(name, GRIPPER)
        results[name] = {"random": measure_random(arm, poses), "path": measure_paths(arm, paths)}
        for kind, row in results[name].items():
            times = "".join(f"{row[key]:10.2f}" for key in ("p50_ms", "p99_ms", "p100_ms"))
            print(f"{name:12} {kind:8} {row['solved']:9.3%}{times}")
    if args.json is not None:
        machine = {"cores": os.cpu_count(), "machine": platform.machine(), "load": os.getloadavg()}
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps({**results, "budget_s": BUDGET_S, "machine": machine}, indent=1))
    return 0


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the results to this file")
    parser.add_argument("--quick", action="store_true", help="a short look")
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main(arguments()))
