"""Measure the main job, `scripts/record_sim`: CPU time of each process, and quality of the recorded episodes.

    scripts/run python scripts/bench_record.py                         five runs of this clone
    scripts/run python scripts/bench_record.py --beside ../before      in turn with another clone, run by run

Run nothing else meanwhile. Arguments after `--` are passed to lerobot-record.
"""

import argparse
import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
_TICKS = os.sysconf("SC_CLK_TCK")
_ROLES = {  # text in the command line → role
    "lerobot-record": "LeRobot",
    "control_process": "control",
    "rig.server.server": "physics",
    "rig.render.renderer": "pictures",
    "rig.operator.operator": "operator",
}
_PERIOD = re.compile(r"control loop: .*p99 ([\d.]+)")
_SETTLE_S, _WINDOW_S = 3.0, 20.0  # first episode: delay after its start, and measured time


def cpu_s(since: float) -> dict[str, float]:
    """Return the CPU time, s, by role, of all processes started after `since`, a time after boot in s."""
    used: dict[str, float] = {}
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError):
            command = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            role = next((name for mark, name in _ROLES.items() if mark in command), None)
            fields = (path / "stat").read_text().rsplit(")", 1)[1].split()
            if role is not None and int(fields[19]) / _TICKS >= since:
                used[role] = used.get(role, 0.0) + (int(fields[11]) + int(fields[12])) / _TICKS
    return used


def record(clone: Path, arguments: list[str]) -> dict[str, Any]:
    """Run the main job once in a clone; return its figures."""
    report: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        data, log = Path(folder) / "data", Path(folder) / "log"
        command = [str(clone / "scripts/record_sim"), f"--dataset.root={data}", *arguments]
        environment = {**os.environ, "PYTHONPATH": str(clone)}
        since, begin = time.clock_gettime(time.CLOCK_BOOTTIME), time.monotonic()
        with open(log, "w") as out:
            job = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, env=environment)
            first = _first_frame(data, job)
            report["first_frame_s"] = first - begin
            time.sleep(_SETTLE_S)
            before, at = cpu_s(since), time.monotonic()
            time.sleep(_WINDOW_S)
            after, took_s = cpu_s(since), time.monotonic() - at
            report["status"] = job.wait()
        report["processors"] = {role: (after[role] - before.get(role, 0.0)) / took_s for role in after}
        text = log.read_text(errors="replace")
        report["warnings_shown"], report["lines_shown"] = text.count("WARNING"), len(text.splitlines())
        whole = data.with_name(f"{data.name}.log")  # includes lines that were not shown
        text = whole.read_text(errors="replace") if whole.is_file() else text
        report["period_p99_ms"] = [float(found) for found in _PERIOD.findall(text)]
        report["error"] = next(iter(re.findall(r"^error: (.*)", text, re.M)), "")
        side_car = data / "meta/yam_episodes.jsonl"
        rows = side_car.read_text().splitlines() if side_car.is_file() else []  # a failed run keeps no episodes
        report["episodes"] = [_episode(json.loads(row)) for row in rows]
        report["flags"] = []
        if not rows:
            return report
        checked = subprocess.run(
            [sys.executable, "-m", "lerobot_robot_yam.commands.data.dataset_check", str(data), "--json"],
            capture_output=True,
            text=True,
            env=environment,
        )
        found = json.loads(checked.stdout)
        flags = [*found["flags"], *(flag for episode in found["episodes"] for flag in episode["flags"])]
        report["flags"] = [flag["kind"] for flag in flags]
    return report


def _first_frame(data: Path, job: subprocess.Popen) -> float:
    """Wait until the first video of a recording begins; return the monotonic time, s."""
    while job.poll() is None:
        if any(data.rglob("*_streaming.mp4")):
            return time.monotonic()
        time.sleep(0.02)
    raise SystemExit(f"the recording ended with status {job.returncode} before its first frame")


def _episode(row: dict[str, Any]) -> dict[str, float]:
    repeated = max(row["repeated_images"].values(), default=0)
    return {"fps": row["achieved_fps"], "late": row["late_frames"], "repeated": repeated / max(row["frames"], 1)}


def summary(name: str, runs: list[dict[str, Any]]) -> str:
    """Return a table of the runs of one clone."""
    lines = [f"{name}: {len(runs)} runs"]
    roles = sorted({role for run in runs for role in run["processors"]})
    for role in roles:
        lines.append(_row(f"processors: {role}", [run["processors"].get(role, 0.0) for run in runs], "{:.2f}"))
    lines.append(_row("processors: all", [sum(run["processors"].values()) for run in runs], "{:.2f}"))
    lines.append(_row("command to first frame, s", [run["first_frame_s"] for run in runs], "{:.1f}"))
    for key, form in (("fps", "{:.2f}"), ("late", "{:.0f}"), ("repeated", "{:.1%}")):
        for number in range(max(len(run["episodes"]) for run in runs)):
            values = [run["episodes"][number][key] for run in runs if number < len(run["episodes"])]
            lines.append(_row(f"episode {number}: {key}", values, form))
    lines.append(_row("flags", [len(run["flags"]) for run in runs], "{:.0f}"))
    lines.append(_row("warnings shown", [run["warnings_shown"] for run in runs], "{:.0f}"))
    lines.append(_row("lines shown", [run["lines_shown"] for run in runs], "{:.0f}"))
    lines.append(_row("period p99, ms", [max(run["period_p99_ms"], default=np.nan) for run in runs], "{:.2f}"))
    lines += [f"  failed: {run['error']}" for run in runs if run["status"]]
    return "\n".join(lines)


def _row(what: str, values: list[float], form: str) -> str:
    return f"  {what:<28}" + "".join(f"{form.format(value):>9}" for value in values)


def main() -> int:
    """Run the benchmark; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, help="of each clone")
    parser.add_argument("--beside", type=Path, help="another clone, run in turn with this one")
    parser.add_argument("--json", type=Path, help="also write the runs here")
    parser.add_argument("arguments", nargs="*", help="of lerobot-record, behind --")
    args = parser.parse_args()
    clones = [*([args.beside.resolve()] if args.beside else []), ROOT]
    runs: dict[str, list[dict[str, Any]]] = {str(clone): [] for clone in clones}
    for _ in range(args.runs):
        for clone in clones:
            runs[str(clone)].append(record(clone, args.arguments))
            print(summary(clone.name, runs[str(clone)][-1:]), flush=True)
            if args.json:
                args.json.write_text(json.dumps(runs, indent=1))
    print("\n".join(summary(Path(clone).name, rows) for clone, rows in runs.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
