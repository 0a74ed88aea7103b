"""The event log on disk outlives the rig."""

import json
import time

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.client.rig_control import RigControl, running_rig, wait_ended


def test_events_survive_the_rig(tmp_path):
    with running_rig(event_dir=str(tmp_path / "logs")) as rig:
        rig.place("cube", [0.3, 0.1, 0.02])
        rig.log("remark", text="hello")
        known = rig.events()
    path = tmp_path / "logs" / f"rig-{rig.name}.events.jsonl"
    written = [json.loads(line) for line in path.read_text().splitlines()]
    assert written[: len(known)] == known
    kinds = [event["kind"] for event in known if event["kind"] != "slipped"]  # a busy machine
    assert kinds == ["rig_started", "placed", "remark"]
    clocks = written[0]
    assert clocks["unix_s"] - clocks["monotonic_s"] == pytest.approx(time.time() - time.monotonic(), abs=0.1)


def test_another_rig_of_the_name_writes_on(tmp_path):
    for _ in range(2):
        with RigControl("evidence", event_dir=str(tmp_path)) as rig:
            rig.log("remark")
            rig.end()
        wait_ended(rig)
    kinds = [json.loads(line)["kind"] for line in (tmp_path / "rig-evidence.events.jsonl").read_text().splitlines()]
    assert kinds.count("rig_started") == kinds.count("remark") == 2


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="event_dir"):
        RigControl.start(event_dir=str(tmp_path / "file" / "logs"))
