"""LeRobot teleoperator for hand guiding: a person moves a floating follower by hand, without a leader."""

import logging
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.face.devices.feature_names import action_keys
from lerobot_robot_yam.face.devices.hand_guidance import HandGuidance
from lerobot_robot_yam.face.operator_keys.typed_keys import listen
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.session.uncopyable import Uncopied
from lerobot_teleoperator_yam.config_yam_hand_guide import BiYamHandGuideConfig, YamHandGuideConfig

logger = logging.getLogger(__name__)

_HALF = 0.5


class HandGuideBase(Uncopied, Teleoperator):
    """Teleoperator for guiding one follower or two by hand.

    Args:
        config: `YamHandGuideConfig` or `BiYamHandGuideConfig`.
    """

    def __init__(self, config: Any):
        super().__init__(config)
        self.config = config
        self._guidance = HandGuidance(self.name, list(self.action_features))
        self._end_keys: Callable[[], None] | None = None
        self._openings: list[float | None] = [None] * len(config.keys())
        self._connected = False

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features of the follower: `joint_1.pos` … (or `ee_x.pos` …), `gripper.pos`; with prefixes for two arms."""
        arms = dict.fromkeys(self.config.prefixes(), self.config)
        return dict.fromkeys(action_keys(arms, self.config.action_space), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Empty mapping: feedback cannot move a person's hand."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether `connect` was called and `disconnect` was not."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Always True: there is nothing to calibrate."""
        return True

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Announce the guide to the next follower; energise nothing. Raises ConfigError: another guide is connected."""
        self._guidance.announce()
        self._openings = [None] * len(self._openings)
        self._connected = True
        logger.info("%s: keys %s open and close grippers", self, ", ".join(self.config.keys()))

    def disconnect(self) -> None:
        """End the guidance; the follower holds. Idempotent."""
        self._connected = False
        try:
            self._guidance.withdraw()
        finally:
            end, self._end_keys = self._end_keys, None
            if end is not None:
                end()

    def calibrate(self) -> None:
        """Do nothing: there is nothing to calibrate."""

    def configure(self) -> None:
        """Do nothing: there is nothing to configure."""

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Return the action for the pose to which the follower was guided. The follower floats from the first call on.

        A gripper's value is the opening last set by key, or the gripper's set-point if its key has not been typed yet.

        Raises:
            LifeCycleError: there is no follower yet, or the follower would move away by itself if it floated.
            MotorError, StaleStateError: see `YamFollower.get_observation`.
        """
        if self._end_keys is None:  # LeRobot's own listener is running by now
            self._end_keys = listen(self._typed)
        return self._guidance.action(self._openings)

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Do nothing: feedback cannot move a person's hand."""

    def _typed(self, key: str) -> None:
        for index, own in enumerate(self.config.keys()):
            if key == own:
                before = self._openings[index]
                now = self._guidance.opening(index) if before is None else before
                self._openings[index] = 0.0 if now > _HALF else 1.0
                logger.info("%s: %s the gripper", self, "closes" if now > _HALF else "opens")


class YamHandGuide(HandGuideBase):
    """Hand guide for one follower."""

    config_class = YamHandGuideConfig
    name = "yam_hand_guide"


class BiYamHandGuide(HandGuideBase):
    """Hand guide for two followers."""

    config_class = BiYamHandGuideConfig
    name = "bi_yam_hand_guide"
