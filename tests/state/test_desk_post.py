"""The status of a command, and what it is asked: both ends, whatever comes."""

import json
import os
import socket
import stat
import subprocess
import sys
import time

import pytest

from lerobot_robot_yam.state import desk_post
from lerobot_robot_yam.state.desk_post import Asked, DeskPost, ask, forget_the_dead, running_desks
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.pages import block
from tests.support.paths import ROOT

OURS = os.getpid()
GOOD = Asked("success", "yam-view", 12.25)


@pytest.fixture
def post(tmp_path):
    post = DeskPost(tmp_path)
    yield post
    post.close()


def send(directory, data):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        ours.sendto(data, str(directory / f"desk-{OURS}.sock"))


def test_a_status_is_found_and_gone_with_its_command(post, tmp_path):
    assert running_desks(tmp_path) == {}
    for phase in ("recording", "resetting"):
        post.tell({"phase": phase})
        assert running_desks(tmp_path)[OURS]["phase"] == phase
    assert running_desks(tmp_path)[OURS]["age_s"] < 60.0
    post.close()
    post.close()
    assert running_desks(tmp_path) == {} and not list(tmp_path.iterdir())


def test_a_request_arrives_as_it_was_sent(post, tmp_path):
    assert ask(tmp_path, OURS, GOOD) and ask(tmp_path, OURS, GOOD._replace(turn=None))
    assert post.asked(1.0) == ([GOOD, GOOD._replace(turn=None)], 0)
    assert not ask(tmp_path, 1, GOOD)


def test_only_this_user_may_ask(post, tmp_path):
    assert stat.S_IMODE((tmp_path / f"desk-{OURS}.sock").stat().st_mode) == 0o600


MALFORMED = [
    b"\0",
    b"next",
    b"[]",
    b"{}",
    b"7",
    b"[" * 500,
    b'{"meaning": "next"}',
    b'{"meaning": 3, "by": "x"}',
    b'{"meaning": "next", "by": ["x"]}',
    b'{"meaning": "next", "by": "a\\nline of the log"}',
    b'{"meaning": "next", "by": "x", "turn": "now"}',
    b'{"meaning": "next", "by": "' + b"x" * 600 + b'"}',
    b"\xff\xfe",
]


@pytest.mark.parametrize("data", MALFORMED, ids=range(len(MALFORMED)))
def test_what_is_no_request_is_counted_only(post, tmp_path, data):
    send(tmp_path, data)
    ask(tmp_path, OURS, GOOD)
    assert post.asked(1.0) == ([GOOD], 1)


def test_a_flood_is_taken_by_the_handful_and_ends(post, tmp_path):
    """Who sends without waiting is turned away when the kernel's queue is full."""
    sent = sum(ask(tmp_path, OURS, GOOD) for _ in range(10_000))
    assert 0 < sent < 10_000
    taken = []
    while batch := post.asked(0.0)[0]:
        assert len(batch) <= 16
        taken += batch
    assert len(taken) == sent
    assert ask(tmp_path, OURS, GOOD) and post.asked(1.0) == ([GOOD], 0)


def test_who_waits_can_be_woken(post):
    began_s = time.monotonic()
    post.wake()
    assert post.asked(60.0) == ([], 0) and time.monotonic() - began_s < 30.0


STAY = """
import pathlib, signal, sys
from lerobot_robot_yam.state.desk_post import DeskPost
post = DeskPost(pathlib.Path(sys.argv[1]))
post.tell({"command": "lerobot-record"})
print("there", flush=True)
signal.pause()
"""


def test_two_commands_are_two_and_a_killed_one_leaves_nothing(post, tmp_path):
    other = subprocess.Popen([sys.executable, "-c", STAY, tmp_path], stdout=subprocess.PIPE, cwd=ROOT)
    with other:
        assert other.stdout.readline() == b"there\n"
        post.tell({})
        assert set(running_desks(tmp_path)) == {OURS, other.pid}
        assert ask(tmp_path, other.pid, GOOD) and post.asked(0.0) == ([], 0)
        other.kill()
    assert set(running_desks(tmp_path)) == {OURS} and not ask(tmp_path, other.pid, GOOD)
    assert list(tmp_path.glob(f"desk-{other.pid}.*"))
    forget_the_dead(tmp_path)
    assert not list(tmp_path.glob(f"desk-{other.pid}.*")) and set(running_desks(tmp_path)) == {OURS}


def test_a_process_takes_over_what_one_with_its_number_has_left(tmp_path):
    for name in (f"desk-{OURS}.json", f"desk-{OURS}.sock"):
        (tmp_path / name).write_text("{}")
    post = DeskPost(tmp_path)
    assert running_desks(tmp_path) == {}  # what the other has said is not ours
    post.tell({"phase": "recording"})
    assert running_desks(tmp_path)[OURS]["phase"] == "recording"
    post.close()


@pytest.mark.parametrize("content", ["", "[]", "{", "7", "[" * 100_000])
def test_a_status_that_is_none_is_not_shown(post, tmp_path, content):
    (tmp_path / f"desk-{OURS}.json").write_text(content)
    (tmp_path / "desk-x.json").write_text(json.dumps({}))
    assert running_desks(tmp_path) == {}


def test_a_directory_whose_name_is_too_long_is_told(tmp_path):
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    with pytest.raises(OSError):
        DeskPost(deep)
    assert desk_post.running_desks(deep) == {}


def test_a_program_does_as_the_docs_say():
    post = DeskPost(runtime_dir())
    try:
        post.tell({"turn": 2.5})
        exec(block("docs/view_desk.md", "python", "running_desks("), {})
        assert post.asked(1.0) == ([Asked("success", "my program", 2.5)], 0)
    finally:
        post.close()
