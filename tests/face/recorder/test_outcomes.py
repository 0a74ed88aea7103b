"""Labels of episodes while LeRobot's own writer records, saves and drops them."""

import pytest

from lerobot_robot_yam.face.lerobot_command.running_command import Phase, Situation
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.face.recorder.outcomes import OutcomeBook
from tests.support.wrecks import CAMERAS, add_frames, create


@pytest.fixture
def data(tmp_path):
    data = create(tmp_path / "data", cameras=())
    yield data
    data.finalize()


@pytest.fixture
def book(data):
    book = OutcomeBook()
    book.open(data)
    return book


def labels(data):
    return {episode: row.outcome for episode, row in outcomes.read(data.root).items()}


def save(data):
    add_frames(data, data.num_episodes, 4)
    data.save_episode()


def test_a_label_is_written_once_its_episode_is_saved(data, book):
    add_frames(data, 0, 4)
    assert book.label("failure", 4, "left_top")
    book.look()
    assert labels(data) == {} and book.pending
    data.save_episode()
    book.look()
    assert labels(data) == {0: "failure"} and not book.pending


def test_a_label_goes_with_an_episode_that_is_recorded_again(data, book):
    add_frames(data, 0, 4)
    book.label("failure", 4, "left_top")
    data.clear_episode_buffer()
    add_frames(data, 0, 4)
    book.look()
    data.save_episode()
    book.look()
    assert labels(data) == {} and not book.pending


def test_a_label_between_episodes_is_of_the_newest_one(data, book):
    save(data)
    assert book.label("discard", 0, "left_top")
    save(data)
    assert labels(data) == {0: "discard"}


def test_a_label_while_videos_are_encoded_together_is_of_the_episode_that_is_counted_already(tmp_path):
    data = create(tmp_path / "batch", CAMERAS[:1], streaming=False, batch=2)
    book = OutcomeBook()
    book.open(data)
    save(data)
    add_frames(data, 1, 4)

    def label_meanwhile(*episodes):  # and encode nothing: only the moment counts
        assert data.num_episodes == 2
        book.label("failure", situation(data).frames, "left_top")
        book.look()

    data.writer._batch_save_episode_video = label_meanwhile
    data.save_episode()
    book.look()
    data.finalize()
    assert labels(data) == {1: "failure"} and not book.pending


def situation(data):
    return Situation("lerobot-record", Phase.BETWEEN, {}, data)


def test_the_newest_label_counts(data, book):
    save(data)
    for outcome in ("failure", "success"):
        book.label(outcome, 0, "left_top")
    assert labels(data) == {0: "success"}


def test_an_earlier_sessions_episode_gets_no_label(data):
    save(data)
    book = OutcomeBook()
    book.open(data)
    assert not book.label("failure", 0, "left_top")
    assert not OutcomeBook().label("failure", 0, "left_top")
    assert labels(data) == {}


def test_an_episode_does_not_inherit_the_label_of_a_lost_one(data):
    save(data)
    outcomes.append(data.root, [outcomes.now(0, "success", "a"), outcomes.now(1, "discard", "a")])
    OutcomeBook().open(data)
    assert labels(data) == {0: "success"}


def test_outcomes_that_cannot_be_read_are_no_obstacle(data, caplog):
    (data.root / outcomes.OUTCOMES).write_text("{}\n{}\n")
    OutcomeBook().open(data)
    assert "line 1 is no outcome" in caplog.text


def test_a_label_of_an_episode_that_is_never_saved_is_dropped(data, book):
    add_frames(data, 0, 4)
    book.label("failure", 4, "left_top")
    book.close()
    assert labels(data) == {} and not book.pending
