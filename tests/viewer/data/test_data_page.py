"""A data set in a real browser: the table, the player, the figures, the pictures; and an episode on an arm.

YAM_DOCS_PICTURE=docs/view_data.png has the first test write the picture of the page there. That of the second test is
docs/view_match.png.
"""

import pytest

from tests.support import big_sets
from tests.support.browser import browser_page, take_picture, yam_view
from tests.support.paths import ROOT

pytestmark = [pytest.mark.long, pytest.mark.alone]

WAIT_MS = 60_000
EPISODES, FRAMES = 3, 90


def scene_of(page):
    """What the canvas of the scene shows."""
    page.wait_for_timeout(700)
    return page.locator("canvas").first.screenshot()


def test_a_data_set_is_opened_scrubbed_and_seen(tmp_path):
    root = big_sets.write(tmp_path / "data", EPISODES, FRAMES, cameras=("top", "left_wrist"), size=(96, 128))
    errors = []
    with yam_view("--dataset", str(root)) as url, browser_page(url, errors) as page:
        page.get_by_text("0 of 3 episodes have flags").wait_for(timeout=WAIT_MS)
        assert page.locator("table tr", has_text="lift the cube").count() == EPISODES
        picture = page.locator("img[src^='blob:']").first
        picture.wait_for(timeout=WAIT_MS)
        page.wait_for_function("[...document.images].some(image => image.naturalWidth === 128)", timeout=WAIT_MS)
        before, seen = scene_of(page), picture.get_attribute("src")
        page.locator(f"[role=slider][aria-valuemax='{FRAMES - 1}']").press("End")
        after = scene_of(page)
        assert before != after
        page.wait_for_function(
            "([image, old]) => image.src !== old", arg=[picture.element_handle(), seen], timeout=WAIT_MS
        )
        take_picture(page, tmp_path)
    assert not errors


def test_an_episode_is_sent_to_the_arms_of_a_rig_and_laid_over_its_camera(tmp_path):
    root = big_sets.write(tmp_path / "data", 2, 60, cameras=("top",), size=(96, 128))
    errors = []
    config = str(ROOT / "configs" / "sim" / "record.yaml")
    with (
        yam_view("--dataset", str(root), "--config_path", config, patient=True) as url,
        browser_page(url, errors, 1200, 900) as page,
    ):
        page.get_by_role("button", name="connect …").click(timeout=WAIT_MS)
        page.get_by_role("button", name="energise", exact=True).click()
        page.get_by_text("the arms hold where they are").wait_for(timeout=WAIT_MS)
        page.get_by_role("button", name="take control").click()
        page.get_by_role("tab", name="Send to the arms").click(timeout=WAIT_MS)
        page.get_by_role("button", name="send to the arms").click()
        page.get_by_text("These arms move").wait_for()
        page.get_by_role("button", name="move the arms").click()
        page.get_by_role("button", name="pause").click(timeout=WAIT_MS)
        page.get_by_role("button", name="go on").click()
        page.get_by_text("replayed; the arms hold").wait_for(timeout=WAIT_MS)
        page.get_by_role("tab", name="Match a scene").click()
        page.get_by_label("live camera").first.click()
        page.get_by_role("option", name="top", exact=True).click()
        page.wait_for_function("[...document.images].some(image => image.naturalWidth === 320)", timeout=WAIT_MS)
        other = page.get_by_label("compare with")
        other.fill("1")
        other.press("Enter")
        page.wait_for_timeout(1000)
        take_picture(page, tmp_path)
        page.get_by_role("button", name="land").click()
        page.get_by_text("the arms have landed").wait_for(timeout=WAIT_MS)
    assert not errors
