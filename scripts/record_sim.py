"""Run the stock `lerobot-record` on configs/sim/record.yaml and say where the data set is.

python scripts/record_sim.py --dataset.num_episodes=5
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main(arguments: list[str]) -> int:
    """Record into a new directory below outputs/, unless the arguments say otherwise; returns the exit status."""
    given = dict(argument.removeprefix("--").partition("=")[::2] for argument in arguments if "=" in argument)
    unused = ROOT / "outputs" / f"yam_sim_{time.strftime('%Y%m%d_%H%M%S')}_{os.getpid()}"
    data = Path(given.get("dataset.root") or unused).absolute()
    name = given.get("dataset.repo_id", "local/yam_sim")
    command = ["lerobot-record", f"--config_path={ROOT / 'configs/sim/record.yaml'}", "--dataset.no_stamp=true"]
    command += [f"--dataset.root={data}", *(a for a in arguments if not a.startswith("--dataset.root="))]
    print("$", " ".join(command))
    sys.stdout.flush()
    child = subprocess.Popen(command)
    # Ctrl-C reaches both processes: LeRobot ends the recording, we wait for it. The others only reach us.
    signal.signal(signal.SIGINT, lambda *_: None)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: child.send_signal(number))
    status = child.wait()
    info = data / "meta" / "info.json"
    if info.is_file():
        held = json.loads(info.read_text())
        print(f"\nThe data set is in {data}")
        print(f"It has {held['total_episodes']} episodes, {held['total_frames']} frames")
        print("Replay it:  scripts/run lerobot-replay --config_path=configs/sim/replay.yaml \\")
        print(f"              --dataset.repo_id={name} --dataset.root={data} --dataset.episode=0")
    return status if status >= 0 else 128 - status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
