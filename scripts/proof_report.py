"""Report of scripts/train_proof.py: training data, policy, and success rate."""

import json
import os
import platform
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from safetensors import safe_open

_Z95 = 1.96


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate (Wilson 1927), which is wide for few trials."""
    rate, z = successes / count, _Z95
    centre = (rate + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(rate * (1 - rate) / count + z**2 / (4 * count**2))
    return float(centre - half), float(centre + half)


def write_report(out: Path, task: str, policy: Path, done: Path, seed: int) -> Path:
    """Write report.md on the evaluation in `done`, whose first seed is `seed`, and the loss plot; return its path."""
    step = policy.resolve().parent.name
    evaluation = json.loads((done / "eval_info.json").read_text())
    successes: Sequence[bool] = evaluation["per_task"][0]["metrics"]["successes"]
    _plot_loss(out / "loss.png", (out / "train.log").read_text(errors="replace"))
    lines = [
        f"# Training proof: {task}",
        "",
        f"**{sum(successes)} of {len(successes)} evaluation episodes succeeded "
        f"({100 * np.mean(successes):.0f} %, 95 % interval {_interval(successes)}).**",
        "",
        "| | |",
        "|---|---|",
        *(f"| {name} | {value} |" for name, value in _facts(out, policy, step, seed, successes).items()),
        "",
        "![Loss of the training](loss.png)",
        "",
        *_videos(evaluation, out),
    ]
    report = out / "report.md"
    report.write_text("\n".join(lines) + "\n")
    return report


def _interval(successes: Sequence[bool]) -> str:
    low, high = wilson(sum(successes), len(successes))
    return f"{100 * low:.0f}–{100 * high:.0f} %"


def _facts(out: Path, policy: Path, step: str, seed: int, successes: Sequence[bool]) -> dict[str, Any]:
    info = json.loads((out / "data" / "meta" / "info.json").read_text())
    tried = json.loads((out / "data" / "seeds.json").read_text())
    config = json.loads((policy / "config.json").read_text())
    times = json.loads((out / "times.json").read_text())
    with safe_open(policy / "model.safetensors", "pt") as weights:
        size = sum(int(np.prod(weights.get_slice(name).get_shape())) for name in weights.keys())
    device = torch.cuda.get_device_name() if torch.cuda.is_available() and config["device"] == "cuda" else "CPU"
    return {
        "data": f"{info['total_episodes']} demonstrations, {info['total_frames']} frames at {info['fps']} fps; "
        f"{sum(tried.values())} of {len(tried)} attempts of the operator succeeded",
        "seeds": f"data {min(map(int, tried))}–{max(map(int, tried))}, evaluation {seed}–{seed + len(successes) - 1}",
        "policy": f"{config['type']}, {size / 1e6:.1f} million parameters; sees {', '.join(config['input_features'])}",
        "training": f"{int(step)} steps",
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, {device}",
        "time": ", ".join(f"{name} {seconds / 60:.0f} min" for name, seconds in times.items()),
    }


def _plot_loss(path: Path, log: str) -> None:
    """Plot the loss logged by lerobot-train against passes over the data, which have more digits than steps."""
    logged = dict(sorted((float(e), float(loss)) for e, loss in re.findall(r"epch:([\d.]+) loss:([\d.]+)", log)))
    figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
    axis.plot(list(logged), list(logged.values()))
    axis.set(xlabel="passes over the data", ylabel="loss", yscale="log")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _videos(evaluation: dict[str, Any], out: Path) -> list[str]:
    paths = evaluation["overall"].get("video_paths", [])
    return (
        ["Videos of the first episodes:", ""] + [f"- `{os.path.relpath(path, out)}`" for path in paths] if paths else []
    )
