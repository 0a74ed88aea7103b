"""End-to-end proof with the stock commands: record, train and evaluate, then write a report with the results.

    python scripts/train_proof.py --out outputs/lift_and_place --episodes 200 --steps 4000

Each step shows its progress and is skipped if it is already done: after an interruption, run the same command again to
continue. All results go to --out: data, checkpoints, evaluation with videos, report.md with its plots.
"""

import argparse
import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

from proof_report import write_report

from lerobot_robot_yam.commands.data.gathering import damage
from lerobot_robot_yam.system.own_commands import install_extra

ROOT = Path(__file__).parent.parent
STEP = Path("training_state", "training_step.json")
LAST_WRITTEN = Path("training_state", "scheduler_state.json")


def run(out: Path, name: str, *command: str) -> None:
    """Run a command with its output on the terminal and in NAME.log; add its duration to times.json.

    Raises:
        SystemExit: the command failed.
    """
    begin = time.monotonic()
    program = Path(sys.executable).parent / command[0]
    process = subprocess.Popen([str(program), *command[1:]], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        copy_output(process, out / f"{name}.log")
        status = process.wait()
    except KeyboardInterrupt:
        copy_output(process, out / f"{name}.log")  # Ctrl-C interrupted the command too, which still completes its files
        process.wait()
        raise
    finally:  # also count the time of a failed or interrupted command
        path = out / "times.json"
        times = json.loads(path.read_text()) if path.exists() else {}
        times[name] = times.get(name, 0.0) + time.monotonic() - begin
        path.write_text(json.dumps(times))
    if status:
        raise SystemExit(f"{command[0]} failed with status {status}; run this again to go on from here")


def copy_output(process: subprocess.Popen[bytes], log: Path) -> None:
    """Copy the output of a process, including progress bars, as it arrives, until the process ends."""
    assert process.stdout is not None
    with log.open("ab") as file:
        while text := process.stdout.read1():  # type: ignore[attr-defined]
            sys.stderr.buffer.write(text)
            sys.stderr.flush()
            file.write(text)


def gather(out: Path, task: str, episodes: int) -> None:
    """Gather demonstrations until there are at least `episodes`."""
    info = out / "data" / "meta" / "info.json"
    mend(out)
    if info.exists() and json.loads(info.read_text())["total_episodes"] >= episodes:
        return
    if newest_checkpoint(out) is not None:
        raise SystemExit(f"{out / 'train'} was trained on fewer demonstrations than {episodes}; give another --out")
    config = f"configs/train/{task}_eval.yaml"
    data = ("--root", str(out / "data"), "--repo-id", f"local/{task}", "--episodes", str(episodes))
    run(out, "gather", "yam-gather", config, *data)


def mend(out: Path) -> None:
    """Repair the demonstrations after a kill; the original data set is kept beside the repaired one."""
    data, killed, repaired = (out / name for name in ("data", "data_killed", "data_repaired"))
    if not data.exists() and repaired.exists():  # this function was killed between its two renames
        repaired.rename(data)
    if not damage(data):
        return
    for leftover in (killed, repaired):
        shutil.rmtree(leftover, ignore_errors=True)
    try:
        run(out, "repair", "yam-repair-dataset", str(data), "--output", str(repaired))
    except SystemExit:
        print(f"nothing of it can be brought back; it is kept as {killed}", file=sys.stderr)
    data.rename(killed)
    if repaired.exists():
        repaired.rename(data)


def train(out: Path, task: str, steps: int, overrides: list[str]) -> Path:
    """Train, or resume training; return the policy of the last checkpoint."""
    last = newest_checkpoint(out)
    whole = (f"--steps={steps}", f"--scheduler.num_decay_steps={steps}")
    given = out / "overrides.json"
    if last is not None and given.exists() and json.loads(given.read_text()) != overrides:
        raise SystemExit(f"{out / 'train'} was trained with {given.read_text()}; give another --out")
    given.write_text(json.dumps(overrides))
    data = (f"--dataset.root={out / 'data'}", f"--output_dir={out / 'train'}")
    if last is None:
        shutil.rmtree(out / "train", ignore_errors=True)  # no checkpoint yet; LeRobot requires a new folder
        (out / "train.log").unlink(missing_ok=True)
        config = (f"--config_path=configs/train/{task}_train.yaml", f"--dataset.repo_id=local/{task}")
        run(out, "train", "lerobot-train", *config, *data, *whole, *overrides)
    elif json.loads((last / STEP).read_text())["step"] < steps:
        resumed = ("--resume=true", f"--config_path={last / 'pretrained_model' / 'train_config.json'}")
        run(out, "train", "lerobot-train", *resumed, *data, *whole, *overrides)
    last = newest_checkpoint(out)
    if last is None:
        raise SystemExit(f"lerobot-train has left no checkpoint in {out / 'train'}")
    return last / "pretrained_model"


def newest_checkpoint(out: Path) -> Path | None:
    """Return the newest complete checkpoint; LeRobot's link `last` is missing briefly during each save."""
    whole = [path.parent.parent for path in out.glob(f"train/checkpoints/[0-9]*/{LAST_WRITTEN}")]
    return max(whole, key=lambda path: int(path.name), default=None)


def evaluate(out: Path, task: str, policy: Path, episodes: int, seed: int) -> Path:
    """Evaluate, unless this policy was already evaluated with these seeds; return the folder of the results."""
    path = f"configs/train/{task}_eval.yaml"
    parts = (policy / "model.safetensors", policy / "config.json", ROOT / path)
    mark = hashlib.sha256(b"".join(part.read_bytes() for part in parts)).hexdigest()[:8]
    done = out / "eval" / f"{policy.resolve().parent.name}-{mark}-seeds-{seed}-{seed + episodes - 1}"
    if (done / "eval_info.json").exists():
        return done
    config = (f"--config_path={path}", f"--policy.path={policy}", f"--seed={seed}")
    where = (f"--eval.n_episodes={episodes}", f"--output_dir={done}")
    run(out, "evaluate", "lerobot-eval", *config, *where)
    return done


def main() -> int:
    """Run all steps; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of everything")
    parser.add_argument("--task", default="lift_and_place", help="has configs/train/TASK_train.yaml and TASK_eval.yaml")
    parser.add_argument("--episodes", type=int, default=200, help="demonstrations (default %(default)s)")
    parser.add_argument("--steps", type=int, default=4_000, help="of training (default %(default)s)")
    parser.add_argument("--eval-episodes", type=int, default=50, help="default %(default)s")
    parser.add_argument("--seed", type=int, default=1000, help="of the first evaluation episode (default %(default)s)")
    options, overrides = parser.parse_known_args()
    if importlib.util.find_spec("accelerate") is None:
        raise SystemExit(f"lerobot-train needs accelerate; {install_extra('train')}")
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    gather(out, options.task, options.episodes)
    policy = train(out, options.task, options.steps, overrides)
    done = evaluate(out, options.task, policy, options.eval_episodes, options.seed)
    report = write_report(out, options.task, policy, done, options.seed)
    print(f"the report is {report}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
