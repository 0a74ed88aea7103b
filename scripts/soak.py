"""Teleoperate a virtual rig for minutes under injected faults; check that no arm falls and that states are true.

    python scripts/soak.py --minutes 20 --seed 1 --json outputs/soak.json

The arms of a separate rig are driven through the shipped LeRobot classes, under a random schedule of faults that is
the same for the same seed (`soak.schedule`). A simulated person re-arms or reconnects. A judge in a separate process
(`soak.monitor`) reads the states and compares them with the true state in the rig. Prints a table; exit status 1 if an
invariant was violated. Uses no arm, display or network, and writes only to its own temporary folders and to --json.
"""

import argparse
import contextlib
import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from soak.mobile import soak_mobile
from soak.schedule import make_schedule
from tqdm import tqdm

logger = logging.getLogger("soak")

_END_S = 15.0  # maximum time for a process to end and for files to disappear


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0, help="how long to teleoperate")
    parser.add_argument("--seed", type=int, default=1, help="of the schedule")
    parser.add_argument(
        "--rate_hz", type=float, default=250.0, help="of the control loops; 125 on a machine with two slow cores"
    )
    parser.add_argument("--pace", type=float, default=1.0, help="so many times as many faults")
    parser.add_argument(
        "--coupled", action="store_true", help="leaders lead at loop rate, behind a gate, with force feedback"
    )
    parser.add_argument(
        "--mobile", action="store_true", help="two arms on a mobile base, driven by a program, in simulated time"
    )
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--verbose", action="store_true", help="a line for every fault and every recovery")
    return parser.parse_args(given)


class Judge:
    """Process of the monitor.

    Args:
        job: input of the monitor.
        begin_s: monotonic time at time 0 of the report.
    """

    def __init__(self, job: dict[str, Any], begin_s: float):
        self.violations: list[dict[str, Any]] = []
        self.summary: dict[str, Any] = {}
        self._begin_s = begin_s
        self._process = subprocess.Popen(
            [sys.executable, "-m", "soak.monitor"],
            cwd=Path(__file__).parent,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(job) + "\n")
        self._process.stdin.flush()
        if not self._process.stdout.readline():
            raise RuntimeError("the soak's monitor did not start; see its trace above")
        self._reader = threading.Thread(target=self._read, name="soak-judge", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            row = json.loads(line)
            if "summary" in row:
                self.summary = row["summary"]
            else:
                self.add(**row)

    def add(self, violation: str, at_s: float, **fields: Any) -> None:
        """Record a violation at a monotonic time."""
        row = {"violation": violation, "at_s": at_s - self._begin_s, **fields}
        self.violations.append(row)
        logger.error("VIOLATION %s", {key: value for key, value in row.items() if key != "history"})

    @property
    def alive(self) -> bool:
        """Whether the monitor is running."""
        return self._process.poll() is None

    def end(self) -> None:
        """End the monitor and receive its summary. Idempotent."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(_END_S)
        self._process.stdout.close()


def soak(args: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Run the soak; return the report."""
    from soak.devices import keys, make_devices
    from soak.injector import Injector
    from soak.operator import Operator
    from soak.teleop import Teleoperation

    from lerobot_robot_yam.rig.control import RigControl, wait_ended

    rig = RigControl.start(seed=args.seed)
    robot, leader = make_devices(rig.name, folder, args.rate_hz, args.coupled)
    begin_s = time.monotonic()
    judge = Judge({"rig": rig.name, "arms": robot.jobs() | leader.jobs()}, begin_s)
    schedule = make_schedule(args.minutes * 60.0, args.seed, args.pace)
    injector: Injector | None = None
    left_over = 0
    try:
        injector = Injector(rig.name, keys(rig.name), schedule)

        def violation(invariant: str, channel: str, what: str) -> None:
            assert injector is not None
            judge.add(invariant, time.monotonic(), channel=channel, what=what, after_injection=injector.position)

        operator = Operator(rig, injector, args.seed, violation, args.coupled)
        teleop = Teleoperation(robot, leader, operator, injector, violation)
        try:
            teleop.connect()
            injector.begin(time.monotonic())
            with tqdm(total=round(args.minutes * 60), unit="s", file=sys.stderr, mininterval=1.0) as progress:
                start_s = time.monotonic()

                def on_tick() -> None:
                    progress.update(int(time.monotonic() - start_s) - progress.n)
                    progress.set_postfix(
                        faults=injector.injected.total(), violations=len(judge.violations), refresh=False
                    )
                    if not judge.alive or injector.error is not None:
                        raise RuntimeError("the soak's monitor or injector has died; see its trace above")

                teleop.run(start_s + args.minutes * 60.0, on_tick)
            left_over = injector.left
            injector.end()
        finally:
            teleop.disconnect()
    finally:
        if injector is not None:
            injector.end()
        judge.end()
        rig.end()
        rig.close()
        wait_ended(rig)
    return {
        "minutes": args.minutes,
        "seed": args.seed,
        "pace": args.pace,
        "coupled": args.coupled,
        "injected": dict(injector.injected),
        "left_over": left_over,
        "judge": judge.summary,
        "caller": {
            "counts": dict(teleop.counts),
            "errors": dict(teleop.errors),
            "oldest_state_s": teleop.oldest_state_s,
        },
        "log": [{"at_s": at_s - begin_s, "kind": row.kind, "what": str(row)} for at_s, row in injector.log],
        "violations": judge.violations,
    }


def left_behind(runtime: Path) -> list[str]:
    """Return processes, and files in the runtime directory, that still exist after a grace period."""
    mark = f"YAM_RUNTIME_DIR={runtime}\0".encode()
    deadline = time.monotonic() + _END_S
    while True:
        found = [str(path.relative_to(runtime)) for path in runtime.rglob("*")]
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError):
                if entry.name.isdigit() and int(entry.name) != os.getpid() and mark in (entry / "environ").read_bytes():
                    found.append(f"process {entry.name}")
        if not found or time.monotonic() > deadline:
            return found
        time.sleep(0.1)


def table(report: dict[str, Any]) -> str:
    """Return a table of all figures by title, the largest values with their locations, and the violations."""
    caller, judge = report["caller"], report["judge"]
    figures = {"injected": report["injected"], "operator and caller": caller["counts"], "errors": caller["errors"]}
    lines = [f"{report['minutes']:.1f} minutes, seed {report['seed']}, pace {report['pace']:g}"]
    for title, rows in {**figures, **judge}.items():
        lines += ["", title, *(f"  {name:<52} {_shown(value)}" for name, value in rows.items())]
    lines += ["", f"oldest state that was returned: {caller['oldest_state_s'] * 1e3:.0f} of 250 ms"]
    lines += [f"left behind: {', '.join(report['left_behind']) or 'nothing'}"]
    lines += [f"violations: {len(report['violations'])}"]
    for row in report["violations"]:
        when = f"{row['at_s']:8.2f} s  after #{row['after_injection']}"
        context = ", ".join(row.get("context", ()))
        lines.append(f"  {when}  {row['violation']}: {row['channel']}: {row['what']}  [{context}]")
    return "\n".join(lines)


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(_shown, value))
    return f"{value:.3f}" if isinstance(value, float) else f"{value}"


def main(args: argparse.Namespace) -> int:
    """Run the soak and report; return exit status 1 if an invariant was violated."""
    base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    runtime, folder = Path(tempfile.mkdtemp(prefix="yam-soak-", dir=base)), Path(tempfile.mkdtemp(prefix="yam-soak-"))
    os.environ["YAM_RUNTIME_DIR"] = str(runtime)  # the soak's emergency stops must not stop other arms
    os.environ.pop("YAM_RIG", None)
    try:
        report = soak_mobile(args.minutes, args.seed, args.pace) if args.mobile else soak(args, folder)
        report["left_behind"] = left_behind(runtime)
    finally:
        shutil.rmtree(runtime, ignore_errors=True)
        shutil.rmtree(folder, ignore_errors=True)
    for name in report["left_behind"]:
        row = {"violation": "nothing is left behind", "at_s": args.minutes * 60.0, "channel": "", "what": name}
        report["violations"].append(row | {"after_injection": len(report["log"])})
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(report, indent=1) + "\n")
    print(table(report))
    return int(bool(report["violations"]))


if __name__ == "__main__":
    options = arguments()
    logging.basicConfig(
        level=logging.WARNING, format="%(asctime)s.%(msecs)03d %(levelname)s %(name)s: %(message)s", datefmt="%H:%M:%S"
    )
    logger.setLevel(logging.INFO if options.verbose else logging.WARNING)
    sys.exit(main(options))
