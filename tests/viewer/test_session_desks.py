"""The session desk of the page beside LeRobot's own `lerobot-record`: what it shows, and what it can ask for."""

import json
import os
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from lerobot.datasets import LeRobotDataset
from viser._messages import RegisterCommandMessage

from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.state.desk_post import Asked, DeskPost, ask, forget_the_dead, running_desks
from lerobot_robot_yam.system.runtime_files import runtime_dir
from lerobot_robot_yam.viewer.serving.page import Page
from lerobot_robot_yam.viewer.session_desks import BUTTONS, SessionDesks
from tests.state.test_desk_post import STAY
from tests.support.armless import TASK, record
from tests.support.paths import ROOT

FPS, WAIT_S = 30, 30.0
CAMERA_KEYS = {*"WASDQE", "arrowup", "arrowdown", "arrowleft", "arrowright"}  # of viser's CameraControls.tsx
LABELS = ["success", "failure", "discard", "success"]


class Operator:
    """Somebody at the page, in a thread of its own: the command has the main one, as it always has."""

    def __init__(self):
        self.page = Page(port=0)
        self.desks = SessionDesks(self.page.server)

    def close(self):
        self.desks.close()
        self.page.close()

    @property
    def folder(self):
        """Of this process, else of any."""
        folders = self.desks._folders
        return folders.get(os.getpid()) or next(iter(folders.values()), None)

    @property
    def text(self):
        return re.sub("<[^>]*>", "\n", self.folder._text.content) if self.folder else ""

    def buttons(self):
        return {meaning for meaning, button in self.folder._buttons.items() if button.visible}

    def wait(self, *words, frames=0):
        """Until the page shows these."""
        deadline = time.monotonic() + WAIT_S
        while not all(word in self.text for word in words) or self.folder.status.get("frames", 0) < frames:
            assert time.monotonic() < deadline, self.text
            self.desks.update(time.monotonic())
            time.sleep(0.02)

    def wait_gone(self):
        deadline = time.monotonic() + WAIT_S
        while self.folder is not None:
            assert time.monotonic() < deadline, self.text
            self.desks.update(time.monotonic())
            time.sleep(0.02)


@pytest.fixture
def operator():
    operator = Operator()
    yield operator
    operator.close()


def beside(root, work, **options):
    """Record while `work` is done in a thread; returns the data set."""

    def careful():
        try:
            work()
        except BaseException:  # nobody is there who would end it
            ask(runtime_dir(), os.getpid(), Asked("stop", "a test that has failed", None))
            raise

    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(careful)
        options = {"episode_time_s": 60, "reset_time_s": 60} | options
        data = record(root, fps=FPS, streaming_encoding=True, **options)
        done.result(WAIT_S)
    return data


def test_four_episodes_are_labelled_from_the_page(operator, tmp_path):
    seen = []

    def work():
        for episode, label in enumerate(LABELS):
            operator.wait(f"episode {episode} ({episode + 1} of 4): recording", "s left", frames=10)
            assert operator.buttons() == {"success", "failure", "discard", "next", "rerecord", "stop"}
            seen.append(operator.text)
            operator.desks.press(label)
            if episode < len(LABELS) - 1:
                operator.wait(f"episode {episode} ({episode + 1} of 4): resetting")
                operator.desks.press("next")
        operator.wait_gone()

    data = beside(tmp_path / "data", work, num_episodes=len(LABELS))
    assert data.num_episodes == len(LABELS)
    rows = outcomes.read(data.root)
    assert [row.outcome for row in rows.values()] == LABELS and {row.by for row in rows.values()} == {"yam-view"}
    figures = [json.loads(line) for line in (data.root / "meta" / "yam_episodes.jsonl").read_text().splitlines()]
    saved = LeRobotDataset(data.repo_id, root=data.root).meta.episodes
    assert [row["frames"] for row in figures] == [row["length"] for row in saved]
    for words in (TASK, "lerobot-record", f"of {FPS} fps", "encoder waits with top", "GB free", "ends episode 0"):
        assert words in seen[0]
    assert "success 1 of 2 (50%), 1 to discard" in seen[3]
    assert not list(runtime_dir().glob("desk-*"))


FLOOD = """
import pathlib, sys
from lerobot_robot_yam.state.desk_post import Asked, ask
for number in range(10_000):
    ask(pathlib.Path(sys.argv[1]), int(sys.argv[2]), Asked("conquer", "a page", None))
"""


def test_again_and_stop_and_what_nobody_can_mean(operator, tmp_path, capfd):
    def work():
        directory, ours = runtime_dir(), os.getpid()
        operator.wait("episode 0 (1 of 9): recording", frames=5)
        early = operator.folder.status["turn"]
        subprocess.run([sys.executable, "-c", FLOOD, directory, str(ours)], cwd=ROOT, check=True)
        operator.desks.press("rerecord")  # perhaps into a queue that is full
        operator.wait("resetting, the episode is dropped", "records episode 0 again")
        assert "success" not in operator.buttons()
        ask(directory, ours, Asked("stop", "a page that shows the past", early))
        operator.desks.press("next")
        operator.wait("episode 0 (1 of 9): recording", frames=5)
        assert running_desks(directory)[ours]["turn"] != early
        operator.desks.press("stop")
        operator.wait_gone()

    data = beside(tmp_path / "data", work, num_episodes=9)
    assert data.num_episodes == 1 and outcomes.read(data.root) == {}
    said = "".join(capfd.readouterr())  # LeRobot has put its own handler into the log
    assert "stop): came too late, lerobot-record has gone on" in said and "that nobody understands" in said


@pytest.mark.parametrize("status", [{"offers": 3}, {"disk_left_s": "x"}, {"root": 7}, {"late": 1, "fps": []}], ids=str)
def test_a_status_of_another_version_ends_no_page(operator, status):
    post = DeskPost(runtime_dir())
    try:
        post.tell(status | {"disk_free_bytes": 10**9})
        operator.wait("is not understood")
        assert operator.buttons() == set()
    finally:
        post.close()
    operator.wait_gone()


def test_keys_do_nothing_while_two_commands_run(operator, tmp_path):
    """Nobody knows which of them is meant; a button is of one."""
    other = subprocess.Popen([sys.executable, "-c", STAY, runtime_dir()], stdout=subprocess.PIPE, cwd=ROOT)
    post = DeskPost(runtime_dir())
    with other:
        assert other.stdout.readline() == b"there\n"
        post.tell({"offers": {"next": "ends it"}, "turn": 2.5})
        operator.wait("ends it")
        assert len(operator.desks._folders) == 2
        operator.desks.press("next")
        operator.desks.update(time.monotonic())
        assert post.asked(0.0) == ([], 0)
        operator.desks._folders[os.getpid()].press("next")
        operator.desks.update(time.monotonic())
        assert post.asked(0.0) == ([Asked("next", "yam-view", 2.5)], 0)
        other.kill()
    post.close()
    forget_the_dead(runtime_dir())
    operator.wait_gone()


def test_every_button_has_a_key_of_its_own_that_moves_no_camera(operator):
    told = operator.page.server._websock_server._broadcast_buffer.message_from_id.values()
    keys = [message.props for message in told if isinstance(message, RegisterCommandMessage)]
    assert len({key.hotkey for key in keys}) == len(keys) == len(BUTTONS)
    assert not {key.hotkey for key in keys if key.modifier is None} & CAMERA_KEYS
