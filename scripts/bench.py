"""Measure this driver beside LeRobot's driver and the vendor's SDK, on the wire of the virtual rig.

    python scripts/bench.py --json outputs/bench.json --plot outputs/bench.png

Takes about five minutes; `--quick` shortens each measurement. Prints a table, writes JSON, and saves a plot of the
period distributions. Needs the package with its `bench` extra. The vendor's SDK (`pip install dreamscale-i2rt`) is
measured if installed. Uses no arm, display or network. Run nothing else on the machine meanwhile.
"""

import argparse
import logging
import os
import platform
import sys
import time
from pathlib import Path
from typing import Any

from bench.measures import STEPS, Results, Settings, report
from bench.report import json_text, plot, table
from tqdm import tqdm

from lerobot_robot_yam.rig.control import RigControl

logger = logging.getLogger("bench")


def machine() -> dict[str, Any]:
    """Describe the machine (CPU, kernel, load, scheduling) before the benchmark starts."""
    with RigControl.start(arms=["follower_left"]) as rig:
        scheduling = rig.stats()["realtime"]
    with open("/proc/cpuinfo") as file:
        models = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    return {
        "cpu": models[0] if models else platform.machine(),
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "load": os.getloadavg(),
        "realtime": scheduling,
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the results to this file")
    parser.add_argument("--plot", type=Path, default=Path("outputs/bench.png"), help="where the plot goes")
    parser.add_argument("--quick", action="store_true", help="a short look: 2 s each instead of 20 s")
    parser.add_argument("--seconds", type=float, help="seconds for each distribution of periods")
    parser.add_argument("--short-seconds", type=float, help="seconds for every other figure")
    return parser.parse_args()


def main(args: argparse.Namespace) -> int:
    """Measure and report; return exit status 1 if a step failed."""
    settings = Settings(
        seconds=args.seconds or (2.0 if args.quick else 20.0),
        short_s=args.short_seconds or (1.0 if args.quick else 5.0),
    )
    results = Results()
    where = machine()
    failed = False
    with tqdm(STEPS, file=sys.stderr, unit="step") as progress:
        for name in progress:
            progress.set_postfix_str(name)
            try:
                STEPS[name](settings, results)
            except Exception as error:
                failed = True
                logger.exception("%s failed", name)
                results.put(name.partition(".")[0], "failed", f"{name}: {error}")
    document = {**report(settings, results), "machine": where}
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json_text(document))
    plot(results.periods_ms, args.plot)
    print(table(document))
    print(f"plot: {args.plot}" + (f", figures: {args.json}" if args.json is not None else ""))
    return int(failed)


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING)
    sys.exit(main(arguments()))
