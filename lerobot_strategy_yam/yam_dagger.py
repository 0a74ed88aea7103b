"""Rollout strategy `yam_dagger`: a policy drives the followers, and a person can take over any arm at any time.

LeRobot's own `dagger` takes over all arms at once, after a pause that is not recorded. `yam_dagger` records each frame,
and an arm changes from policy to leader or back between two frames. The leaders have to lead their followers (option
`follower`); with `mirror` the leaders are in the followers' pose when a take-over begins.
"""

import logging
import math
import time
from collections import deque
from collections.abc import Mapping, Set
from typing import Any

import numpy as np
from lerobot.datasets import VideoEncodingManager
from lerobot.rollout.strategies.core import RolloutStrategy, safe_push_to_hub
from lerobot.utils.constants import ACTION, OBS_STR
from lerobot.utils.feature_utils import build_dataset_frame
from lerobot.utils.keyboard_input import create_key_listener
from lerobot.utils.robot_utils import precise_sleep
from lerobot.utils.utils import log_say

from lerobot_robot_yam.face.devices.feature_names import space_of
from lerobot_robot_yam.face.operator_keys import requests
from lerobot_strategy_yam.config_yam_dagger import SIDES, YamDaggerStrategyConfig
from lerobot_strategy_yam.take_over import HELP, Action, TakenArms, TakeOverSignals, Wish

logger = logging.getLogger(__name__)


class _Episodes:
    """Episodes of the data set. Frames are added without a gap, then the episode is kept or discarded.

    Args:
        dataset: LeRobot's data set, open for writing.
        features: LeRobot's features of the frames.
        task: task of each frame.
        longest: maximum number of frames in an episode.

    Attributes:
        saved: number of saved episodes.
    """

    def __init__(self, dataset: Any, features: Mapping[str, Any], task: str, longest: int):
        self._dataset, self._features, self._task, self._longest = dataset, features, task, longest
        self._frames = self.saved = 0
        # observation, action and taken arms of the newest frame, which a press may still change
        self._newest: tuple[dict[str, Any], Action, set[str]] | None = None

    @property
    def full(self) -> bool:
        """Whether the current episode has its maximum length."""
        return self._frames >= self._longest

    def add(self, observation: Mapping[str, Any], action: Mapping[str, float], taken: Set[str]) -> None:
        """Add a frame: observation, action, and the prefixes of the arms that a person drove."""
        self._write()
        self._newest = build_dataset_frame(self._features, observation, prefix=OBS_STR), dict(action), set(taken)
        self._frames += 1

    def correct(self, action: Mapping[str, float], pressed: Set[str]) -> None:
        """Replace these arms' part of the newest frame: a press within the frame gave them to the person.

        action: the targets that the arms have executed since the press.
        """
        if self._newest is not None:
            self._newest[1].update({key: action[key] for key in action if key.startswith(tuple(pressed))})
            self._newest[2].update(pressed)

    def _write(self) -> None:
        """Write the newest frame, if there is one, which is final."""
        if self._newest is None:
            return
        (frame, action, taken), self._newest = self._newest, None
        frame |= build_dataset_frame(self._features, action, prefix=ACTION)
        arms = np.array(["" in taken or f"{side}_" in taken for side in SIDES])
        told = {"intervention": np.array([bool(taken)]), "intervention_arms": arms}
        told = {key: told[key] for key in told if key in self._dataset.features}  # a resumed data set may be older
        self._dataset.add_frame(frame | {"task": self._task} | told)

    def keep(self) -> bool:
        """Save the current episode, unless it is empty. Return whether an episode was saved."""
        if not self._frames:
            return False
        self._write()
        self._dataset.save_episode()
        logger.info("episode %d saved, %d frames", self.saved, self._frames)
        self._frames, self.saved = 0, self.saved + 1
        return True

    def discard(self) -> None:
        self._newest = None
        if self._frames:
            self._dataset.clear_episode_buffer()
            logger.info("episode %d discarded, %d frames", self.saved, self._frames)
            self._frames = 0


class YamDaggerStrategy(RolloutStrategy):
    """Strategy for one rollout.

    Args:
        config: options of the strategy.
    """

    config: YamDaggerStrategyConfig

    def __init__(self, config: YamDaggerStrategyConfig):
        super().__init__(config)
        self._listener: Any = None

    def setup(self, ctx: Any) -> None:
        """Start the policy, and listen to leaders and keys.

        Raises:
            ConfigError: the teleoperator is not a YAM leader with a follower, or a button has two meanings.
        """
        cfg = ctx.runtime.cfg
        self._signals = TakeOverSignals(ctx.hardware.teleop, self.config)
        self._init_engine(ctx)
        self._ctx, self._cfg, self._multiplier = ctx, cfg, self._interpolator.multiplier
        joints = space_of(ctx.data.ordered_action_keys) == "joint"  # a rotation vector cannot be blended linearly
        self._arms = TakenArms(self._signals.prefixes, self.config.hand_back_s if joints else 0.0)
        ticks = round(self.config.rewind_s * cfg.fps * self._multiplier)
        self._way_back: deque[Action] = deque(maxlen=max(ticks, 1))  # last actions sent, for the rewind
        self._rewinds = self._policy_runs = self._compiled = False
        longest = max(round(cfg.dataset.episode_time_s * cfg.fps), 1)
        task = cfg.dataset.single_task or cfg.task
        self._episodes = _Episodes(ctx.data.dataset, ctx.data.dataset_features, task, longest)
        self._seen: dict[str, Any] = {}
        self._listener = create_key_listener(self._signals.key, controls_help=HELP)
        requests.join(self._signals, first=True)
        logger.info("yam_dagger is ready: %s", HELP)

    def run(self, ctx: Any) -> None:
        """Drive until `--dataset.num_episodes` are saved, `--duration` has elapsed, or a person stops the command."""
        period_s = 1.0 / (self._cfg.fps * self._multiplier)
        due_s = begin_s = time.perf_counter()
        ends_s = begin_s + self._cfg.duration if self._cfg.duration > 0 else math.inf
        number = 0
        with VideoEncodingManager(ctx.data.dataset):
            try:
                while due_s < ends_s and not ctx.runtime.shutdown_event.is_set() and self._obey():
                    self._tick(is_frame=number % self._multiplier == 0)
                    number += 1
                    due_s = max(due_s + period_s, time.perf_counter())  # no burst after a stall
                    precise_sleep(max(due_s - time.perf_counter(), 0.0))
            finally:
                self._engine.pause()
                self._episodes.keep()

    def _obey(self) -> bool:
        """Handle the person's requests since the last tick. Return False to stop."""
        wanted, wishes = self._signals.look()
        if Wish.REWIND in wishes:
            wanted = self._signals.give_all_back()
            if wanted:
                logger.warning("%s: still taken over by its gate; nothing goes back", " and ".join(map(_arm, wanted)))
            else:
                logger.info("the arms go back along their way")
                self._keep()
                self._rewinds = True
        if wanted:
            self._rewinds = False
        self._share(wanted)
        if Wish.DISCARD in wishes:
            self._episodes.discard()
        elif Wish.KEEP in wishes or self._episodes.full:
            self._keep()
        return Wish.STOP not in wishes and self._episodes.saved < self._cfg.dataset.num_episodes

    def _share(self, wanted: set[str]) -> None:
        """Let the person drive the arms with these prefixes, and the policy the other arms."""
        for prefix in sorted(wanted - self._arms.taken):
            logger.info("%s is taken over", _arm(prefix))
            self._arms.take(prefix)
        given_back = sorted(self._arms.taken - wanted)
        for prefix in given_back:
            logger.info("%s is given back", _arm(prefix))
            self._arms.give_back(prefix)
        runs = not (self._arms.all_taken or self._rewinds)
        if runs and (given_back or not self._policy_runs):
            self._restart_policy()
        elif self._policy_runs and not runs:
            self._engine.pause()
        self._policy_runs = runs

    def _keep(self) -> None:
        if self._episodes.keep():
            log_say(f"Episode {self._episodes.saved} saved", self._cfg.play_sounds)

    def _restart_policy(self) -> None:
        """Make the policy plan from its next observation: the old plan belongs to another pose of the arms."""
        self._interpolator.reset()
        self._engine.reset()
        self._engine.resume()

    def _tick(self, is_frame: bool) -> None:
        """Observe, send the next action, record the frame."""
        processors, robot = self._ctx.processors, self._ctx.hardware.robot_wrapper
        observation = robot.get_observation()
        if is_frame:
            self._seen = processors.robot_observation_processor(observation)
            self._engine.notify_observation(self._seen)
        action = self._next_action(observation)
        if not action:
            return
        if not self._rewinds:
            self._episodes.correct(action, self._signals.pressed & self._arms.taken)
        robot.send_action(processors.robot_action_processor((action, observation)))
        if self._rewinds:
            return
        self._way_back.append(action)
        if is_frame:
            self._episodes.add(self._seen, action, self._arms.taken)
            self._log_telemetry(self._seen, action, self._ctx.runtime)

    def _next_action(self, observation: dict[str, Any]) -> Action:
        """Return the next action of all arms; empty before the policy's first action."""
        if self._rewinds:
            if self._way_back:
                back = self._way_back.pop()
                self._arms.resume(back)
                return back
            self._rewinds = False
        person = None
        if self._arms.taken:
            given = self._ctx.hardware.teleop.get_action()
            person = self._ctx.processors.teleop_action_processor((given, observation))
        policy = self._policy_action() if self._policy_runs else None
        return self._arms.action(time.perf_counter(), policy, person)

    def _policy_action(self) -> Action | None:
        """Return the policy's next action, or None if the policy has none yet."""
        if self._cfg.use_torch_compile and not self._compiled:
            if not self._engine.ready:
                return None
            self._restart_policy()  # actions planned before compiling finished are too old
            self._compiled = True
        if self._interpolator.needs_new_action():
            frame = build_dataset_frame(self._ctx.data.dataset_features, self._seen, prefix=OBS_STR)
            planned = self._engine.get_action(frame)
            if planned is not None:
                self._interpolator.add(planned.cpu())
        row = self._interpolator.get()
        return None if row is None else dict(zip(self._ctx.data.ordered_action_keys, row.tolist(), strict=True))

    def teardown(self, ctx: Any) -> None:
        """Finish the data set, and upload it if requested; then move the arms to their start pose, and land."""
        requests.leave(self._signals)
        self._signals.end()
        if self._listener is not None:
            self._listener.stop()
        options = ctx.runtime.cfg.dataset
        ctx.data.dataset.finalize()
        if options.push_to_hub:
            safe_push_to_hub(ctx.data.dataset, tags=options.tags, private=options.private)
        self._teardown_hardware(ctx.hardware, return_to_initial_position=ctx.runtime.cfg.return_to_initial_position)


def _arm(prefix: str) -> str:
    return f"the {prefix.replace('_', ' ')}arm"
