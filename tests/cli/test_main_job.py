"""The main job at full length, judged by the rig's own log: record, look, replay. Minutes: `-m long`."""

import itertools
import re
import time
from datetime import datetime

import av
import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.rig.control import running_rig
from tests.cli.conftest import Commands
from tests.cli.test_record import BI_KEYS, CAMERAS, MOVES, motion
from tests.support import transfers
from tests.support.rigged import sim_config
from tests.support.set_points import SetPointWatch

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.timeout(900)]

SAME_PLACE_M = 0.03
REPLAYS = 5
MOST_SLOW = 0.02  # of LeRobot's ticks
RATE_HZ = 250  # of the control loops: the default
SHARED_RATE_HZ = 125  # of four of them, where two jobs share two processors


def wall_times(output):
    """Wall times of LeRobot's log lines (begin, end) of each episode, to the second."""
    lines = re.findall(r"INFO (\S+ \S+) \S+ (Recording episode|Reset the environment|Stop recording)", output)
    stamps = [(datetime.strptime(stamp, "%Y-%m-%d %H:%M:%S").timestamp(), what) for stamp, what in lines]
    return [(begin, end) for (begin, what), (end, _) in itertools.pairwise(stamps) if what == "Recording episode"]


def check_pace(output, rows, rate_hz):
    """LeRobot kept its rate, and so did both control loops."""
    slow = output.count("running slower")
    assert slow <= MOST_SLOW * rows, f"{slow} of {rows} ticks were slow"
    periods_ms = [float(p50) for p50 in re.findall(r"control loop: .* period p50 (\S+) ms", output)]
    assert periods_ms == pytest.approx([1e3 / rate_hz] * 2, abs=0.1)


def rig_events(rig):
    """Events of a rig, their times as wall times."""
    events, offset = rig.events(), time.time() - time.monotonic()
    for event in events:
        for key in ("start", "end"):
            if key in event:
                event[key] += offset
    return events


def within(events, begin, end):
    """Transfers that began and ended in a span, with a second's slack for LeRobot's log."""
    return [e for e in events if e["kind"] == "transfer" and e["start"] >= begin - 1 and e["end"] <= end + 1]


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """The shipped config at full length, on a rig of its own: what the first README command runs."""
    directory = tmp_path_factory.mktemp("job")
    root = directory / "data"
    with running_rig(operator="pick_and_place") as rig:
        rig.load(transfers.__file__)
        commands = Commands(rig, directory)
        status = commands.run(
            "lerobot-record",
            "--config_path=configs/sim/record.yaml",
            f"--dataset.root={root}",
            "--dataset.no_stamp=true",
            timeout_s=300,
        )
        events = rig_events(rig)
    assert status == 0, commands.output()[-4000:]
    return commands, LeRobotDataset("local/yam_sim", root=root), events


def test_two_episodes_in_canonical_form_at_full_rate(job):
    commands, data, _ = job
    assert data.num_episodes == 2 and data.fps == 30
    assert list(data.features["action"]["names"]) == BI_KEYS == list(data.features["observation.state"]["names"])
    check_pace(commands.output(), len(data), RATE_HZ)
    assert "Encoder queue full" not in commands.output()  # LeRobot drops frames then


@pytest.mark.parametrize("camera", CAMERAS)
def test_videos_show_27_distinct_frames_a_second(job, camera):
    _, data, _ = job
    for episode in range(2):
        path = data.root / data.meta.get_video_file_path(episode, f"observation.images.{camera}")
        row = data.meta.episodes[episode]
        begin, end = (row[f"videos/observation.images.{camera}/{edge}_timestamp"] for edge in ("from", "to"))
        with av.open(str(path)) as video:
            frames = [
                frame.to_ndarray(format="rgb24")
                for frame in video.decode(video=0)
                if begin - 1e-3 <= frame.time < end - 1e-3
            ]
        assert len(frames) == row["length"]
        distinct = sum(not np.array_equal(a, b) for a, b in itertools.pairwise(frames))
        assert distinct >= 27 * len(frames) / 30
        assert np.median(motion(frames)) > MOVES


def test_each_episode_holds_a_full_cycle_of_the_task(job):
    commands, _, events = job
    spans = wall_times(commands.output())
    assert len(spans) == 2
    for begin, end in spans:
        assert transfers.cycles(within(events, begin, end)), f"no cycle between {begin} and {end}: {events}"


def test_replays_put_the_cube_where_the_recording_put_it(job, tmp_path):
    commands, data, events = job
    begin, end = wall_times(commands.output())[0]
    recorded = within(events, begin, end)
    good, report = 0, []
    for run in range(REPLAYS):
        directory = tmp_path / f"run{run}"
        directory.mkdir()
        with running_rig() as rig:
            rig.load(transfers.__file__)
            replay = Commands(rig, directory)
            with SetPointWatch(rig.name, [sim_config(rig, c) for c in ("follower_left", "follower_right")]) as watch:
                status = replay.run(
                    "lerobot-replay",
                    "--config_path=configs/sim/replay.yaml",
                    f"--dataset.repo_id={data.repo_id}",
                    f"--dataset.root={data.root}",
                    "--dataset.episode=0",
                )
            assert watch.findings == [] and all(0.1 < ratio <= 1.0 for ratio in watch.ratios.values())
            assert status == 0, replay.output()[-4000:]
            time.sleep(0.5)
            carried = [e for e in rig.events() if e["kind"] == "transfer"]
        if len(carried) >= len(recorded):
            last = carried[len(recorded) - 1]
            off = float(np.linalg.norm(np.subtract(last["to"]["xy_m"], recorded[-1]["to"]["xy_m"])))
            report.append((len(carried), last["carry_m"], off))
            good += last["carry_m"] >= transfers.CARRY_M and off <= SAME_PLACE_M
        else:
            report.append((len(carried), 0.0, float("inf")))
    assert good >= REPLAYS - 1, f"(transfers, last carry, distance): {report}; recorded {len(recorded)}"


def test_two_jobs_side_by_side(tmp_path):
    arms = itertools.product(("robot", "teleop"), ("left", "right"))
    rates = [f"--{device}.{side}_arm_config.rate_hz={SHARED_RATE_HZ}" for device, side in arms]
    jobs = []
    for name in ("one", "two"):
        directory = tmp_path / name
        directory.mkdir()
        commands = Commands(None, directory)
        arguments = ["--config_path=configs/sim/record.yaml", f"--dataset.root={directory / 'data'}", *rates]
        jobs.append((commands, commands.start("lerobot-record", *arguments, "--dataset.no_stamp=true")))
    ends = [commands.finish(process, timeout_s=400) for commands, process in jobs]
    for (commands, _), status in zip(jobs, ends, strict=True):
        output = commands.output()
        landed = sorted(re.findall(r"(\w+): landed\n", output))
        assert landed == ["left_follower", "left_leader", "right_follower", "right_leader"], output[-4000:]
        assert status == 0, output[-4000:]
        data = LeRobotDataset("local/yam_sim", root=commands.directory / "data")
        assert data.num_episodes == 2
        check_pace(output, len(data), SHARED_RATE_HZ)
        for episode, camera in itertools.product(data.meta.episodes, CAMERAS):  # with a picture for every row
            begin, end = (episode[f"videos/observation.images.{camera}/{edge}_timestamp"] for edge in ("from", "to"))
            assert round((end - begin) * data.fps) == episode["length"]
