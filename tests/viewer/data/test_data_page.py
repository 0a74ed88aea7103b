"""A data set in a real browser: the table, the player, the figures, the pictures; and an episode on an arm."""

from tests.support import big_sets
from tests.support.browser import browser_page, yam_view

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
        picture = page.locator("img[src^='blob:'], img[src^='data:']").first
        picture.wait_for(timeout=WAIT_MS)
        page.wait_for_function("image => image.naturalWidth === 128", arg=picture.element_handle(), timeout=WAIT_MS)
        before, seen = scene_of(page), picture.get_attribute("src")
        frame = page.get_by_label("frame").last
        frame.fill("70")
        frame.press("Enter")
        after = scene_of(page)
        assert before != after
        page.wait_for_function("([image, old]) => image.src !== old", arg=[picture.element_handle(), seen])
    assert not errors
