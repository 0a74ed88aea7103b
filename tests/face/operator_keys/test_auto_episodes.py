"""Automatic episodes against a recorder that loops as lerobot-record does, and leaders that are lifted at random."""

import itertools
import math
import random

import pytest

from lerobot_robot_yam.face.lerobot_command.running_command import AGAIN, RECORD, Meaning, Phase, Situation
from lerobot_robot_yam.face.operator_keys.auto_episodes import AutoEpisodes, all_lifted
from lerobot_robot_yam.state.modes import Gate
from tests.face.operator_keys.test_key_plan import EPISODES, Dataset

HOME, LIFTED, MIXED = False, True, None
FPS = 30
STOPPED = "stopped"  # which begins the gate anew


class Recorder:
    """The loops of lerobot-record: each frame of an episode is what the leaders did then."""

    def __init__(self, episodes, episode_frames=10**6, reset_frames=10**6, tells_time=True):
        self.tells_time = tells_time
        self.episodes, self.limits = episodes, {Phase.RECORDING: episode_frames, Phase.RESETTING: reset_frames}
        self.saved, self.buffer, self.phase, self.turn, self.left = [], [], Phase.RECORDING, 1.0, episode_frames
        self.exit_early = self.rerecord = self.ended = False

    def situation(self):
        data, left_s = Dataset(len(self.buffer)), self.left / FPS if self.tells_time else math.inf
        return Situation(RECORD, self.phase, EPISODES, data, self.turn, left_s, {AGAIN: self.rerecord})

    def press(self, key):
        self.exit_early = True
        self.rerecord |= key is Meaning.RERECORD

    def tick(self, lifted):
        if self.exit_early or self.left == 0:
            self.exit_early = False
            self._leave()
        elif self.phase is Phase.RECORDING:
            self.buffer.append(lifted)
        self.left -= 1

    def _leave(self):
        last = len(self.saved) == self.episodes - 1
        if self.phase is Phase.RECORDING and (self.rerecord or not last):
            return self._enter(Phase.RESETTING)
        if self.rerecord:
            self.rerecord = self.exit_early = False
        else:
            assert self.buffer, "LeRobot raises"
            self.saved.append(self.buffer)
        self.buffer = []
        self.ended = len(self.saved) == self.episodes
        self._enter(Phase.RECORDING)

    def _enter(self, phase):
        self.phase, self.left = phase, self.limits[phase]
        self.turn += 1.0


def session(recorder, leaders, ticks=3000):
    """Run until the recorder has ended; keys arrive one tick late, whatever it does by then."""
    auto, held, pressed = AutoEpisodes(), None, []
    for lifted in itertools.islice(leaders, ticks):
        if recorder.ended:
            break
        key = auto.key(HOME if lifted is STOPPED else lifted, lifted is not STOPPED, recorder.situation())
        if held is not None:
            recorder.press(held[0])
            pressed.append(held[0])
        held = None if key is None or (held is not None and held[1] == recorder.turn) else (key, recorder.turn)
        recorder.tick(lifted)
    return pressed


def lifts(*lengths):
    """Leaders at home for so long, lifted for so long, …, then home for ever."""
    for index, length in enumerate(lengths):
        yield from itertools.repeat(LIFTED if index % 2 else HOME, length)
    yield from itertools.repeat(HOME)


def test_an_episode_is_saved_while_the_leaders_are_home():
    recorder = Recorder(episodes=3)
    session(recorder, lifts(40, 50, 100), ticks=120)
    assert [len(episode) > 40 for episode in recorder.saved] == [True]


def test_a_lift_and_a_return_are_answered_at_the_look_that_sees_them():
    recorder, auto = Recorder(episodes=1), AutoEpisodes()

    def look(lifted):
        key = auto.key(lifted, True, recorder.situation())
        if key is not None:
            recorder.press(key)
        recorder.tick(lifted)
        return key

    assert look(HOME) is None  # before the first frame
    assert look(HOME) is Meaning.RERECORD
    assert [look(HOME) for _ in range(5)] == [None] * 5 and recorder.phase is Phase.RESETTING
    assert look(LIFTED) is Meaning.NEXT
    assert [look(LIFTED) for _ in range(9)] == [None] * 9
    assert look(HOME) is Meaning.NEXT


def test_leaders_that_are_lifted_from_the_start_are_brought_home_first():
    recorder = Recorder(episodes=1)
    session(recorder, lifts(0, 50, 30, 60))
    assert len(recorder.saved) == 1 and 54 < recorder.saved[0].count(LIFTED) <= 60


@pytest.mark.parametrize("reset_frames", [3, 10, 25])
def test_a_wait_that_is_longer_than_the_reset_records_nothing(reset_frames):
    recorder = Recorder(episodes=2, reset_frames=reset_frames)
    session(recorder, lifts(200, 50, 200, 60))
    assert len(recorder.saved) == 2
    assert all(episode.count(LIFTED) > 40 and episode.count(HOME) < 5 for episode in recorder.saved)


@pytest.mark.parametrize("tells_time", [True, False])
def test_a_lift_at_the_moment_at_which_the_reset_ends_saves_no_fragment(tells_time):
    for wait in range(50, 80):  # the first reset ends within
        recorder = Recorder(episodes=2, reset_frames=60, tells_time=tells_time)
        session(recorder, lifts(wait, 50, 20, 60))
        assert [episode.count(LIFTED) > 38 for episode in recorder.saved] == [True, True], wait


def test_home_at_the_moment_at_which_the_episode_ends_saves_it_and_no_fragment():
    for length in range(90, 110):
        recorder = Recorder(episodes=2, episode_frames=100, reset_frames=2)
        session(recorder, lifts(20, length, 30, 60))
        assert [episode.count(LIFTED) > 50 for episode in recorder.saved] == [True, True], length


def test_an_episode_that_is_too_long_is_saved_and_the_next_one_needs_another_lift():
    recorder = Recorder(episodes=2, episode_frames=30)
    session(recorder, lifts(20, 100, 30, 25))
    assert len(recorder.saved[0]) == 29  # and the tick that sees the end of its time
    assert 18 < recorder.saved[1].count(LIFTED) <= 25


def test_one_leader_alone_neither_begins_nor_ends():
    recorder = Recorder(episodes=1)
    leaders = [HOME] * 20 + [MIXED] * 30 + [LIFTED] * 40 + [MIXED] * 30 + [HOME] * 20
    session(recorder, leaders)
    (episode,) = recorder.saved
    assert 34 < episode.count(LIFTED) <= 40 and episode.count(MIXED) == 30


@pytest.mark.parametrize("stopped", [1, 40])
def test_an_episode_that_an_emergency_stop_cuts_off_is_not_saved(stopped):
    recorder = Recorder(episodes=1)
    leaders = [HOME] * 20 + [LIFTED] * 50 + [STOPPED] * stopped + [HOME] * 40 + [LIFTED] * 30 + [HOME] * 20
    session(recorder, leaders)
    (episode,) = recorder.saved
    assert 24 < episode.count(LIFTED) <= 30 and STOPPED not in episode


def test_a_stop_while_the_scene_is_reset_costs_nothing():
    recorder = Recorder(episodes=2)
    session(
        recorder, [HOME] * 20 + [LIFTED] * 50 + [HOME] * 20 + [STOPPED] * 9 + [HOME] * 20 + [LIFTED] * 40 + [HOME] * 20
    )
    assert [episode.count(LIFTED) > 30 for episode in recorder.saved] == [True, True]


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize(("command", "keys"), [("the episodic strategy of lerobot-rollout", EPISODES), (RECORD, {})])
def test_no_key_for_a_policys_episodes_or_a_command_that_does_not_listen_yet(command, keys, phase):
    for lifted in (HOME, LIFTED, HOME):
        assert AutoEpisodes().key(lifted, True, Situation(command, phase, keys, Dataset(9), 1.0)) is None


@pytest.mark.parametrize("seed", range(100))
def test_random_lifts(seed):
    rng = random.Random(seed)
    lengths = [rng.randint(15, 60) for _ in range(20)]
    recorder = Recorder(episodes=10, reset_frames=rng.choice([20, 10**6]))
    session(recorder, lifts(*lengths))
    assert len(recorder.saved) == 10
    for episode, length in zip(recorder.saved, lengths[1::2], strict=True):
        assert length - 12 < episode.count(LIFTED) <= length  # what is lost is the way of a key
        assert episode.count(HOME) < 5


GATES = [
    ([Gate.IDLE, Gate.IDLE], False),
    ([Gate.HOMING, Gate.IDLE], False),
    ([Gate.APPROACH, Gate.ENGAGED], True),
    ([Gate.FINE, Gate.RECENTRE], True),
    ([Gate.ENGAGED, Gate.HOMING], None),
    ([Gate.ENGAGED], True),
    ([Gate.NONE, Gate.NONE], None),
    ([Gate.NONE, Gate.IDLE], None),
]


@pytest.mark.parametrize(("gates", "lifted"), GATES)
def test_leaders_are_lifted_together(gates, lifted):
    assert all_lifted(gates) is lifted
