"""Hand as a LeRobot teleoperator: it guides a floating follower, without a leader."""

import inspect
import logging
from collections.abc import Callable, Mapping
from functools import cached_property
from types import FrameType
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected
from lerobot.utils.keyboard_input import TerminalKeyListener, create_key_listener

from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS, motor_names
from lerobot_robot_yam.face.devices.hand_guidance import HandGuidance
from lerobot_robot_yam.face.lerobot_command.running_command import callers
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.system.uncopyable import Uncopied
from lerobot_teleoperator_yam.config_yam_hand_guide import BiYamHandGuideConfig, YamHandGuideConfig

logger = logging.getLogger(__name__)

_HALF = 0.5


class TypedKeys:
    """Keys for the driver itself, heard through LeRobot's key listener and in its thread.

    Args:
        pressed: called with LeRobot's name of the key: a character, or a word such as "left".
    """

    def __init__(self, pressed: Callable[[str], None]):
        self._pressed = pressed
        self._listens = False
        self._end: Callable[[], None] = lambda: None

    def listen(self, frame: FrameType | None) -> None:
        """Begin to listen, at the first call, when LeRobot's own listener runs; `frame` is where LeRobot has called.

        A terminal has only one reader: if that is LeRobot's listener, keys are passed on from there.
        """
        if self._listens:
            return
        self._listens = True
        theirs = _listener(frame)
        if theirs is None:
            own = create_key_listener(self._tell)
            self._end = (lambda: None) if own is None else own.stop
            return
        heard = theirs._on_key

        def both(key: str) -> None:
            self._tell(key)
            heard(key)

        def leave() -> None:
            theirs._on_key = heard

        theirs._on_key, self._end = both, leave

    def stop(self) -> None:
        """Stop listening. Idempotent."""
        end, self._end, self._listens = self._end, lambda: None, False
        end()

    def _tell(self, key: str) -> None:
        try:
            self._pressed(key)
        except Exception:
            logger.exception("the key %r was not understood", key)


def _listener(frame: FrameType | None) -> TerminalKeyListener | None:
    """Find the key listener of the command that has called down to `frame`, if it reads a terminal."""
    for caller in callers(frame):
        values = caller.f_locals
        for found in (values.get("listener"), getattr(values.get("self"), "_listener", None)):
            if isinstance(found, TerminalKeyListener):
                return found
    return None


class HandGuideBase(Uncopied, Teleoperator):
    """Teleoperator: hands that guide one follower, or two.

    Args:
        config: `YamHandGuideConfig` or `BiYamHandGuideConfig`.
    """

    def __init__(self, config: Any):
        super().__init__(config)
        self.config = config
        self._guidance = HandGuidance(self.name, list(self.action_features))
        self._keys = TypedKeys(self._typed)
        self._openings: list[float | None] = [None] * len(config.keys())
        self._connected = False

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features of the follower: `joint_1.pos` … (or `ee_x.pos` …), `gripper.pos`; with prefixes for two."""
        joints, gripper = load_arm(self.config.arm).joint_count, load_gripper(self.config.gripper).motor is not None
        names: list[str] = []
        for prefix in self.config.prefixes():
            of_arm = motor_names(prefix, joints, gripper)
            if self.config.action_space == "ee":
                of_arm[:joints] = [f"{prefix}{name}" for name in TOOL_NUMBERS]
            names += of_arm
        return dict.fromkeys([f"{name}.pos" for name in names], float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Empty: a hand cannot be led."""
        return {}

    @property
    def is_connected(self) -> bool:
        """True between connect and disconnect."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """True: there is nothing to calibrate."""
        return True

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Announce the guide, without energising, to the next follower. Raises ConfigError: there is another guide."""
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
            self._keys.stop()

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Action at the pose to which the hand has led the follower, which floats from the first call on.

        A gripper's part is the opening that its key has set last; before that, the present opening.

        Raises:
            LifeCycleError: there is no follower yet, or it would run away if it floated.
            MotorError, StaleStateError: see `YamFollower.get_observation`.
        """
        self._keys.listen(inspect.currentframe())
        return self._guidance.action(self._openings)

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Nothing to do: a hand cannot be led."""

    def _typed(self, key: str) -> None:
        for index, own in enumerate(self.config.keys()):
            if key == own:
                before = self._openings[index]
                now = self._guidance.opening(index) if before is None else before
                self._openings[index] = 0.0 if now > _HALF else 1.0
                logger.info("%s: %s the gripper", self, "closes" if now > _HALF else "opens")


class YamHandGuide(HandGuideBase):
    """Hand that guides one follower."""

    config_class = YamHandGuideConfig
    name = "yam_hand_guide"


class BiYamHandGuide(HandGuideBase):
    """Hands that guide two followers."""

    config_class = BiYamHandGuideConfig
    name = "bi_yam_hand_guide"
