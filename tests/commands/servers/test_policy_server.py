"""yam-policy-server as a command: it serves until Ctrl-C, and says what is wrong with its options."""

import logging
import os
import re
import signal
import threading
import time

import pytest

from lerobot_robot_yam.commands.servers.policy_server import main
from tests.face.openpi.serving.conftest import Client
from tests.support.tiny_policies import N, observations, save_tiny


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return save_tiny(tmp_path_factory.mktemp("checkpoint"), "act")


@pytest.fixture(autouse=True)
def _level():
    """The command makes our loggers tell more."""
    logger = logging.getLogger("lerobot_robot_yam")
    before = logger.level
    yield
    logger.setLevel(before)


def test_it_serves_until_it_is_interrupted(checkpoint, caplog):
    answers = []

    def ask():
        try:
            deadline = time.monotonic() + 60.0
            while not (told := re.search(r"listening on ws://127.0.0.1:(\d+)", caplog.text)):
                assert time.monotonic() < deadline
                time.sleep(0.02)
            client = Client(int(told[1]))
            answers.append(client.ask(observations("act", 1)[0]))
            answers.append(client.metadata)
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=ask)
    thread.start()
    assert main([f"--policy.path={checkpoint}", "--port=0", "--policy.n_action_steps", "3"]) == 0
    thread.join()
    actions, metadata = answers
    assert actions["actions"].shape == (3, N) and metadata["action_horizon"] == 3
    assert "has gone after 1 answers" in caplog.text and "interrupted" in caplog.text


@pytest.mark.parametrize(
    "options, named",
    [
        (("--host=0.0.0.0",), "with --host=0.0.0.0 the whole network could use it"),
        (("--api-key-env=NO_SUCH_KEY",), "--api-key-env names NO_SUCH_KEY, which is not set"),
        (("--policy.discover_packages_path=no_such_package",), "no_such_package"),
        (("--port=99999",), "nobody can listen on 127.0.0.1 port 99999"),
    ],
)
def test_wrong_options_are_one_line(checkpoint, capsys, options, named):
    assert main([f"--policy.path={checkpoint}", *options]) == 1
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("yam-policy-server:")]
    assert named in line


@pytest.mark.parametrize("options", [("--rename_map=3",), ("--no-such-option",), ("--policy.no_such_field=3",)])
def test_unknown_options_are_wrong_use(checkpoint, capsys, options):
    with pytest.raises(SystemExit) as ended:
        main([f"--policy.path={checkpoint}", *options])
    assert ended.value.code == 2 and options[0].partition("=")[0].split(".")[-1] in capsys.readouterr().err
