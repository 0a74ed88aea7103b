"""Measure what yam-view costs a recording: lerobot-record with four arms and three cameras, on two processors.

    python scripts/bench_view.py --json outputs/bench_view.json

Takes about three minutes; `--quick` a short look. One recording of the virtual rig's operator for each row: alone,
beside yam-view that nobody looks at, and beside one with a browser. A browser draws elsewhere, on a graphics card or on
another computer. So a client stands for it that takes everything that the page sends. The row `chromium`, only if it is
asked for, has a headless one draw on the same two processors.
"""

import argparse
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from lerobot_robot_yam.state.desk_post import running_desks
from lerobot_robot_yam.system.runtime_files import runtime_dir

ROOT = Path(__file__).resolve().parent.parent
CASES = ("alone", "page", "page and browser")
CHROMIUM = ["chromium", "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
_SIDE_CAR = Path("meta", "yam_episodes.jsonl")
_LOOP = re.compile(r"control loop: (\d+) cycles, (\d+) overruns, .* p99 ([\d.]+), p99.9 ([\d.]+), max ([\d.]+)")
_HEAD = 16  # bytes before the compressed messages: their lengths, see viser's _message_producer
_WARM_S = 1.0  # of a recording, that does not count
_LOOKED_S = 0.2


class Looker:
    """Takes what the page sends, as a browser does, and counts how often something has moved."""

    def __init__(self, url: str):
        protocol = f"viser-v{viser.__version__}"
        self._socket = connect(url.replace("http", "ws"), subprotocols=[protocol], compression=None, max_size=None)
        self.moves_s: list[float] = []
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        unpack = zstandard.ZstdDecompressor()
        with contextlib.suppress(ConnectionClosed):
            for packet in self._socket:
                length = int.from_bytes(packet[8:_HEAD], "little")
                window = msgspec.msgpack.decode(unpack.decompress(packet[_HEAD : _HEAD + length]))
                if any(message["type"] == "SetOrientationMessage" for message in window["messages"]):
                    self.moves_s.append(time.monotonic())

    def close(self) -> None:
        """Leave."""
        self._socket.close()
        self._thread.join()


@contextlib.contextmanager
def page() -> Iterator[tuple[str, int]]:
    """yam-view; its address and the number of its process."""
    command = [sys.executable, "-m", "lerobot_robot_yam.commands.pages.view", "--port", "0"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        yield process.stderr.readline().split()[1], process.pid
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate()


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def record(seconds: float) -> tuple[dict[str, Any], float]:
    """One episode; what its side-car and the control loops say of it, and when it began, s of the monotonic clock."""
    with tempfile.TemporaryDirectory() as folder, open(Path(folder, "said"), "w+") as said:
        data, begun_s = Path(folder, "data"), 0.0
        command = [str(Path(sys.executable).with_name("lerobot-record")), "--config_path=configs/sim/record.yaml"]
        command += [f"--dataset.root={data}", "--dataset.no_stamp=true", "--dataset.num_episodes=1"]
        command += [f"--dataset.episode_time_s={seconds}", "--dataset.reset_time_s=0"]
        run = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        while run.poll() is None:
            desks = running_desks(runtime_dir()) if not begun_s else {}
            if any(status.get("phase") == "recording" for status in desks.values()):
                begun_s = time.monotonic()
            time.sleep(_LOOKED_S)
        said.seek(0)
        text = said.read()
        if run.returncode:
            raise SystemExit(text[-4000:])
        row = json.loads((data / _SIDE_CAR).read_text().splitlines()[-1])
    loops = [tuple(map(float, found)) for found in _LOOP.findall(text)]
    gaps_ms = np.diff(row["times_s"]) * 1e3
    figures = {
        "frames": row["frames"],
        "achieved_fps": row["achieved_fps"],
        "late_frames": row["late_frames"],
        "frame_p99_ms": float(np.percentile(gaps_ms, 99)),
        "frame_max_ms": float(gaps_ms.max()),
        "late_ticks": int(sum(loop[1] for loop in loops)),
        "ticks": int(sum(loop[0] for loop in loops)),
        "loop_p99_ms": max(loop[2] for loop in loops),
        "loop_p999_ms": max(loop[3] for loop in loops),
        "loop_max_ms": max(loop[4] for loop in loops),
    }
    return figures, begun_s


def measure(case: str, seconds: float) -> dict[str, Any]:
    """One row."""
    if case == "alone":
        return record(seconds)[0]
    with page() as (url, pid), contextlib.ExitStack() as stack:
        looker = stack.enter_context(contextlib.closing(Looker(url))) if case != "page" else None
        if case == "chromium":
            profile = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
            browser = subprocess.Popen(
                [*CHROMIUM, f"--user-data-dir={profile}", "--remote-debugging-port=0", url],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            stack.callback(browser.wait)
            stack.callback(os.killpg, browser.pid, signal.SIGTERM)
        used_s, started_s = cpu_s(pid), time.monotonic()
        row, begun_s = record(seconds)
        row["page_cpu"] = (cpu_s(pid) - used_s) / (time.monotonic() - started_s)
        if looker is not None:
            moves_s, span_s = np.array(looker.moves_s) - begun_s - _WARM_S, seconds - 2 * _WARM_S
            moves_s = moves_s[(moves_s > 0.0) & (moves_s < span_s)]
            row["updates_hz"] = len(moves_s) / span_s
            row["update_gap_ms"] = float(np.diff(moves_s).max() * 1e3) if len(moves_s) > 1 else None
    return row


def table(rows: dict[str, dict[str, Any]]) -> str:
    """For documents."""
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    lines = [f"| | {' | '.join(rows)} |", f"|---|{'---|' * len(rows)}"]
    for name in names:
        cells = [row.get(name) for row in rows.values()]
        shown = [f"{cell:.3g}" if isinstance(cell, float) else "–" if cell is None else str(cell) for cell in cells]
        lines.append(f"| {name} | {' | '.join(shown)} |")
    return "\n".join(lines)


def main(args: argparse.Namespace) -> int:
    """Measure every row, one after another; print the table."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    rows = {case: measure(case, 6.0 if args.quick else args.seconds) for case in args.only}
    print(table(rows))
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps({"load": os.getloadavg(), "rows": rows}, indent=1))
    return 0


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=32.0, help="length of each recording (default 32)")
    parser.add_argument("--quick", action="store_true", help="a short look: 6 s each")
    parser.add_argument("--only", nargs="+", choices=(*CASES, "chromium"), default=CASES, help="only these rows")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main(arguments()))
