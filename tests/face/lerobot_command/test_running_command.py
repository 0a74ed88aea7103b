"""Which command runs, and what a signal does to it."""

import inspect
import math
import time
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.face.datasets.layout import is_empty
from lerobot_robot_yam.face.lerobot_command.running_command import Phase, recording, under_a_command
from lerobot_robot_yam.face.recorder.kept_episodes import stop_after_saving
from tests.support.lerobot_calls import SCRIPTS, called_by

RECORD = SCRIPTS / "lerobot_record.py"
WHY = "ended by SIGINT"


def data_set(buffer, episodes=0, root=None):
    return SimpleNamespace(writer=SimpleNamespace(episode_buffer=buffer), num_episodes=episodes, root=root)


def in_record(call, dataset, events, file=RECORD):
    cfg = SimpleNamespace(dataset=SimpleNamespace(num_episodes=3), resume=False)
    return called_by(file, "record", call, dataset=dataset, cfg=cfg, events=events)


def in_loop(call, dataset, begin_s=1.0):
    return called_by(RECORD, "record_loop", call, dataset=dataset, start_episode_t=begin_s, control_time_s=30.0)


def strike():
    return stop_after_saving(inspect.currentframe(), WHY)


@pytest.mark.parametrize("buffer", [{"size": 30}, {"frame_index": []}], ids=["not saved yet", "being saved"])
def test_a_finished_episode_is_saved_before_the_command_ends(buffer):
    dataset, events = data_set(buffer), {"stop_recording": False, "exit_early": False}
    assert in_record(lambda: in_loop(strike, None), dataset, events)
    assert events["exit_early"] and bool(events["stop_recording"])  # LeRobot does not reset, and saves
    dataset.writer.episode_buffer = {"size": 0}
    with pytest.raises(KeyboardInterrupt, match=WHY):
        bool(events["stop_recording"])


def test_an_episode_that_is_being_recorded_does_not_hold_a_signal_up():
    dataset, events = data_set({"size": 30}), {"stop_recording": False}
    assert not in_record(lambda: in_loop(strike, dataset), dataset, events)
    assert events == {"stop_recording": False}


def test_when_its_loop_ends_by_itself_is_known():
    now = in_record(lambda: in_loop(recording, None, time.perf_counter()), data_set({"size": 0}), {})
    assert now.phase is Phase.RESETTING and 29.0 < now.left_s < 30.0
    assert in_record(recording, data_set({"size": 0}), {}).left_s == math.inf


def test_nothing_is_promised_while_the_command_ends_by_an_error():
    def fails():
        try:
            raise RuntimeError("a motor is hot")
        finally:
            found.append(strike())

    found = []
    with pytest.raises(RuntimeError):
        in_record(fails, data_set({"size": 30}), {"stop_recording": False})
    assert found == [False]


def test_other_programs_are_no_command(tmp_path):
    dataset, events = data_set({"size": 30}), {"stop_recording": False}
    assert recording() is None and not under_a_command()
    assert in_record(recording, dataset, events).dataset is dataset
    assert in_record(recording, dataset, events, tmp_path / "lerobot_record.py") is None
    assert called_by(RECORD, "record", recording, dataset=None, cfg=None) is None


def test_what_is_no_data_set_is_not_empty(tmp_path):
    assert not is_empty(tmp_path) and not is_empty(tmp_path / "nothing")
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text("[]")
    assert not is_empty(tmp_path)
