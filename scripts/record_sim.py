"""Run the stock `lerobot-record` on configs/sim/record.yaml; report the location and quality of the data set.

python scripts/record_sim.py --dataset.num_episodes=5
python scripts/record_sim.py -v        shows all output of LeRobot, which otherwise goes to a file beside the data set
"""

import os
import shlex
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from record_log import RecordLog

if TYPE_CHECKING:
    from lerobot_robot_yam.face.datasets.check.dataset_report import DatasetReport

ROOT = Path(__file__).resolve().parent.parent
_CHEAPER = "--teleop.left_arm_config.can_options={operator: pick_and_place, pictures: plain}"
_MOST = 3  # maximum number of episodes listed at the end; the others are in the report


def main(arguments: list[str]) -> int:
    """Record into a new directory below outputs/, unless the arguments name one; return the exit status."""
    given = dict(argument.removeprefix("--").partition("=")[::2] for argument in arguments if "=" in argument)
    unused = ROOT / "outputs" / f"yam_sim_{time.strftime('%Y%m%d_%H%M%S')}_{os.getpid()}"
    data = Path(given.get("dataset.root") or unused).absolute()
    name = given.get("dataset.repo_id", "local/yam_sim")
    command = ["lerobot-record", f"--config_path={ROOT / 'configs/sim/record.yaml'}", "--dataset.no_stamp=true"]
    command += [f"--dataset.root={data}"]
    command += [a for a in arguments if not a.startswith("--dataset.root=") and a not in ("-v", "--verbose")]
    print("$", shlex.join(command))
    sys.stdout.flush()
    path = data.with_name(f"{data.name}.log")
    log = None if len(set(arguments) & {"-v", "--verbose"}) else RecordLog(path)
    child = subprocess.Popen(command) if log is None else log.start(command)
    # Ctrl-C reaches both processes: LeRobot ends the recording, we wait. The other signals reach only this process.
    signal.signal(signal.SIGINT, lambda *_: None)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: child.send_signal(number))
    status = child.wait() if log is None else log.follow(child)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    if log is not None:
        more = f"; a warning that was shown came again {log.left_out} times" if log.left_out else ""
        print(f"\nAll that was said is in {_short(path)}{more}")
    if (data / "meta" / "info.json").is_file():
        _tell(data, name)
    return status if status >= 0 else 128 - status


def _tell(data: Path, name: str) -> None:
    """Print the location and quality of the data set, and commands to continue with."""
    from lerobot_robot_yam.commands.data.dataset_command import bar
    from lerobot_robot_yam.errors import ConfigError
    from lerobot_robot_yam.face.datasets.check.dataset_report import check_dataset

    where = _short(data)
    print(f"The data set is in {where}", flush=True)
    try:
        report = check_dataset(data, progress=partial(bar, what="checking the data set"))
    except ConfigError as error:
        print(f"It cannot be checked: {error}")
    else:
        _judge(report, where)
    print(f"Look at it:  scripts/run yam-view --dataset {where}")
    print(f"Check it:    scripts/run yam-dataset-check {where}")
    replay = _short(ROOT / "configs/sim/replay.yaml")
    print(f"Replay it:   scripts/run lerobot-replay --config_path={replay} --dataset.repo_id={name} \\")
    print(f"               --dataset.root={where} --dataset.episode=0")


def _judge(report: "DatasetReport", where: str) -> None:
    """Print the quality of each episode; for episodes that would harm training, print the defect and the remedy."""
    from lerobot_robot_yam.face.datasets.check.flags import Kind
    from lerobot_robot_yam.face.recorder.kept_episodes import drop_command, read_figures

    figures, count, flagged = read_figures(report.root), len(report.episodes), report.flagged
    shown = report.episodes if count <= _MOST else flagged[:_MOST]
    for episode in shown:
        row = figures.get(episode.number, {})
        repeated = sum(row.get("repeated_images", {}).values())
        rate = f" at {row['achieved_fps']:.1f} of {report.fps:g} fps, {repeated} repeated images" if row else ""
        verdict = "WRONG: " + "; ".join(flag.text for flag in episode.flags[:_MOST]) if episode.flags else "good"
        print(f"  episode {episode.number}: {episode.frames} frames{rate}: {verdict}")
    if len(shown) < count:
        print(f"  {count} episodes in all, {count - len(flagged)} of them good")
    for flag in report.flags[:_MOST]:
        print(f"  {flag.kind}: {flag.text}: {flag.kind.remedy}")
    if not flagged:
        return
    kinds = {flag.kind for episode in flagged for flag in episode.flags}
    if kinds & {Kind.REAL_RATE, Kind.LATE, Kind.CAMERA_SLOW}:
        print("What to do:  this machine was too busy; end other programs, or record pictures that cost less:")
        print(f"             scripts/record_sim {shlex.quote(_CHEAPER)}")
    else:
        print(f"What to do:  {flagged[0].flags[0].kind.remedy}")
    bad = [episode.number for episode in flagged]
    print("Drop:       ", f"scripts/run {drop_command(where, bad)}" if len(bad) < count else f"rm -r {where}")


def _short(path: Path) -> str:
    """Return the path in a form that can be pasted into this shell."""
    return shlex.quote(str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
