"""A session of four episodes, labelled in a real browser by button and by key; and the picture of docs/view_desk.md.

YAM_DOCS_PICTURE=docs/view_desk.png has the test write it there.
"""

import subprocess
import sys

import pytest

from lerobot_robot_yam.face.recorder import outcomes
from tests.support.browser import browser_page, take_picture, yam_view
from tests.support.paths import ROOT

pytestmark = [pytest.mark.long, pytest.mark.alone]

WAIT_MS = 60_000
LABELS = ["success", "failure", "discard", "success"]
RECORDING = """
import sys
from tests.support.armless import ArmlessConfig, record
record(sys.argv[1], ArmlessConfig(size=(240, 320)), fps=30, num_episodes=4, episode_time_s=60, reset_time_s=60,
       streaming_encoding=True)
"""


def test_a_session_is_labelled_by_button_and_by_key(tmp_path):
    root, errors = tmp_path / "data", []
    with open(tmp_path / "output.txt", "wb") as output:
        recording = subprocess.Popen(
            [sys.executable, "-c", RECORDING, root], cwd=ROOT, stdout=output, stderr=subprocess.STDOUT
        )
    try:
        with yam_view() as url, browser_page(url, errors, 1280, 1000) as page:

            def shown(text):
                page.get_by_text(text, exact=False).first.wait_for(timeout=WAIT_MS)

            def ask(episode, button, key):
                if episode % 2:
                    page.keyboard.press(f"Shift+{key}")
                else:
                    page.get_by_role("button", name=f"{button} [Shift+{key.upper()}]").click()

            for episode, label in enumerate(LABELS):
                shown(f"episode {episode} ({episode + 1} of 4): recording")
                page.wait_for_timeout(2_000)
                if episode == 3:
                    take_picture(page, tmp_path)
                page.keyboard.press("q")  # moves the camera, and ends nothing
                ask(episode, label, label[0])
                if episode < 3:
                    shown(f"episode {episode} ({episode + 1} of 4): resetting")
                    ask(episode, "next", "n")
            page.get_by_text("lerobot-record").first.wait_for(state="detached", timeout=WAIT_MS)
        assert recording.wait(60.0) == 0, (tmp_path / "output.txt").read_text(errors="replace")[-4000:]
    finally:
        recording.kill()
        recording.wait()
    assert [row.outcome for row in outcomes.read(root).values()] == LABELS and not errors
