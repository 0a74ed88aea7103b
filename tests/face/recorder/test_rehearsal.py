"""Before the first episode cameras and encoder run until frames come in time, and nothing of that is kept."""

import threading
import time

import pytest

from lerobot_robot_yam.face.recorder import rehearsal
from lerobot_robot_yam.face.recorder.rehearsal import rehearse
from tests.support.armless import ArmlessConfig, record
from tests.support.wrecks import CODER

FPS = 20
ONE = {"num_episodes": 1, "episode_time_s": 0.3, "fps": FPS, "rgb_encoder": CODER}


def encoders():
    return sum(type(thread).__name__ == "_CameraEncoderThread" for thread in threading.enumerate())


@pytest.mark.parametrize("streaming", [True, False])
def test_frames_are_rehearsed_with_an_encoder_at_work_and_none_is_kept(tmp_path, streaming):
    seen = []
    robot = ArmlessConfig(rehearsal=lambda: seen.append(encoders()))
    data = record(tmp_path / "data", robot, streaming_encoding=streaming, **ONE)
    assert len(seen) >= rehearsal._PUNCTUAL and set(seen) == {int(streaming)}
    assert 1 <= data.num_frames <= 0.3 * FPS + 1
    assert {path.name for path in data.root.iterdir()} <= {"data", "images", "meta", "videos"}
    assert encoders() == 0


def test_a_machine_that_is_too_slow_is_told_of_and_records_all_the_same(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(rehearsal, "_LONGEST_S", 0.3)
    robot = ArmlessConfig(rehearsal=lambda: time.sleep(2.0 / FPS))
    rehearsal.logger.addHandler(caplog.handler)  # LeRobot may have taken all others away
    try:
        assert record(tmp_path / "data", robot, **ONE).num_episodes == 1
    finally:
        rehearsal.logger.removeHandler(caplog.handler)
    (warning,) = {record.getMessage() for record in caplog.records if record.name == rehearsal.__name__}
    assert warning.startswith("frames still come late after 0 s") and "end other programs" in warning


def test_other_commands_do_not_rehearse():
    rehearse(lambda: pytest.fail("it did"))
