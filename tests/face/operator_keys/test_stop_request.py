"""A button that stops a recording, pressed at every line of LeRobot's own recorder."""

import __future__

import ast
import contextlib
import functools
import itertools
import sys
import types

import pytest

from lerobot_robot_yam.face.lerobot_command.running_command import look
from lerobot_robot_yam.face.operator_keys.key_plan import StopRequest
from tests.support.lerobot_calls import SCRIPTS
from tests.support.tiers import spread

RECORD = SCRIPTS / "lerobot_record.py"
FRAME_S = 0.01
FRAMES = 4  # of an episode that nobody ends: more lines than any `delay`
EPISODES = 3


class Data:
    """A data set of LeRobot that refuses to save an episode without a frame.

    Attributes:
        drops: the present episode is to be dropped.
        saved: frames of each episode.
    """

    num_episodes, fps, features = 0, 1 / FRAME_S, {}

    def __init__(self, drops):
        self.writer, self.drops = self, drops
        self.episode_buffer, self.saved = {"size": 0}, []

    def add_frame(self, frame):
        self.episode_buffer["size"] += 1

    def save_episode(self):
        if not self.episode_buffer["size"]:
            raise ValueError("You must add one or several frames")
        self.saved.append(self.episode_buffer["size"])
        self.num_episodes += 1
        self.clear_episode_buffer()

    def clear_episode_buffer(self):
        self.episode_buffer, self.drops = {"size": 0}, False

    def finalize(self):
        pass


@functools.cache
def code():
    """Of LeRobot's `record` and its loop."""
    tree = ast.parse(RECORD.read_text())
    tree.body = [node for node in tree.body if getattr(node, "name", "") in ("record", "record_loop")]
    for node in tree.body:
        node.decorator_list = []
    return compile(tree, str(RECORD), "exec", flags=__future__.annotations.compiler_flag)


def recorder(data, events, reset_time_s):
    """LeRobot's `record`, ready to be called, with a robot that does nothing and a clock of its own."""
    now_s = itertools.count()
    teleop = types.SimpleNamespace(connect=dict, get_action=dict, is_connected=False)
    robot = types.SimpleNamespace(connect=dict, get_observation=dict, send_action=str, name="", cameras={})
    robot.is_connected, robot.action_features, robot.observation_features = False, {}, {}
    scope = dict.fromkeys(
        ("aggregate_pipeline_dataset_features", "combine_feature_dicts", "create_initial_features", "init_logging"),
        lambda *_, **__: {},
    )
    scope |= {
        "ACTION": "action",
        "OBS_STR": "observation",
        "KeyboardTeleop": type("KeyboardTeleop", (), {}),
        "LeRobotDataset": types.SimpleNamespace(create=lambda *_, **__: data),
        "Teleoperator": types.SimpleNamespace,
        "VideoEncodingManager": lambda dataset: contextlib.nullcontext(),
        "asdict": vars,
        "build_dataset_frame": lambda *_, **__: {},
        "init_keyboard_listener": lambda: (None, events),
        "log_say": lambda *_, **__: None,
        "logging": types.SimpleNamespace(info=lambda *_: None, warning=lambda *_: None),
        "make_default_processors": lambda: [lambda given: given] * 3,
        "make_robot_from_config": lambda _: robot,
        "make_teleoperator_from_config": lambda _: teleop,
        "pformat": str,
        "precise_sleep": lambda _: None,
        "time": types.SimpleNamespace(perf_counter=lambda: next(now_s) * FRAME_S / 3.0),  # asked three times a frame
    }
    exec(code(), scope)

    class Options(types.SimpleNamespace):
        def __getattr__(self, name):
            return 0

    times = {"episode_time_s": FRAMES * FRAME_S, "reset_time_s": reset_time_s, "num_episodes": EPISODES}
    dataset = Options(repo_id="local/x", fps=data.fps, stamp_repo_id=dict, **times)
    return lambda: scope["record"](Options(dataset=dataset, teleop=True))


class Press:
    """A button that is pressed at line number `at` of the recorder; the command is looked at every `delay` lines then.

    Attributes:
        wanted: how many episodes there are to be in the end; None before it was pressed.
    """

    def __init__(self, data, at, delay):
        self._data, self._at, self._delay = data, at, delay
        self._stop, self._line, self.wanted = None, -1, None

    def __call__(self, frame, event, _):
        if frame.f_code.co_filename != str(RECORD):
            return None
        if event == "line":
            self._line += 1
            if self.wanted is None and self._line >= self._at:
                self._press(look())
            elif self._stop is not None and (self._line - self._at) % self._delay == 0 and self._stop.advance(look()):
                self._stop = None
        return self

    def _press(self, now):
        if now.flags:
            self.wanted = len(self._data.saved) + bool(now.frames and not self._data.drops)
            self._stop = StopRequest(now)


def recorded(at, delay, reset_time_s, rerecord):
    """The data set of a session in which the button was pressed there, and the press."""
    data, events = Data(rerecord), {"exit_early": False, "rerecord_episode": rerecord, "stop_recording": False}
    record, press = recorder(data, events, reset_time_s), Press(data, at, delay)
    before = sys.gettrace()
    sys.settrace(press)
    try:
        record()
    finally:
        sys.settrace(before)
    return data, press


@pytest.mark.parametrize("reset_time_s", [0.0, 2 * FRAME_S])
@pytest.mark.parametrize("rerecord", [False, True])
@pytest.mark.parametrize("delay", spread([1, 40], 1))
def test_no_moment_ends_an_episode_without_a_frame_or_loses_one_or_records_another(delay, rerecord, reset_time_s):
    """`rerecord`: the first episode is to be dropped."""
    for at in itertools.count(50):  # before, nothing is connected
        data, press = recorded(at, delay, reset_time_s, rerecord)
        if press.wanted is None:
            assert at > 200 and len(data.saved) == EPISODES
            break
        assert len(data.saved) == press.wanted, at
