"""Parts of YAM devices for LeRobot's RL stack (`lerobot.rl`): a follower's motor bus, a leader's events and steps.

The action of a leader is a step of the follower's end effector along x, y and z, and a command for its gripper:

    delta_x, delta_y, delta_z      -1 … 1, as a fraction of the maximum step per frame, along the axes of the arm's base
    gripper                        0 opens, 1 stops, 2 closes

LeRobot's own names of the gripper's values are reversed, for arms whose grippers close with increasing values.

A step is the motion of the leader's end effector since the person took over, minus the previous steps. Therefore the
follower does not jump to the leader, and motion beyond the length of one step follows in the next steps.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from lerobot.teleoperators.utils import TeleopEvents

from lerobot_robot_yam.errors import ActionError, ConfigError, YamError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup
from lerobot_robot_yam.face.devices.feature_names import STEPS
from lerobot_robot_yam.face.devices.pair_check import Models
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning
from lerobot_robot_yam.face.operator_keys.auto_episodes import LIFTED
from lerobot_robot_yam.face.operator_keys.handle_buttons import Presses
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode

logger = logging.getLogger(__name__)

# Constants of `MotorBus.sync_write`
_THERE = 2e-3  # distance from the target at which the arm counts as arrived, rad or fraction of the stroke
_MOVES = 1e-4  # minimum change of the set-point between ticks that counts as motion, rad or fraction of the stroke
_BLOCKED_S = 0.5  # time without motion that ends the wait, s, as in an emergency stop or at the workspace's edge
_TICK_S = 0.01  # interval between sent targets, s

# Constants of `TeleopEventWatch`
_PERIOD_S = 0.005  # polling interval of the handles, s; LeRobot reads events ten times per second
_RESET_S = 0.5  # pause between LeRobot's calls that indicates a reset of the arm by LeRobot, s
_END_S = 1.0  # timeout of joining the thread, s
_EVENTS = {
    Meaning.SUCCESS: (TeleopEvents.SUCCESS,),
    Meaning.FAILURE: (TeleopEvents.TERMINATE_EPISODE,),
    Meaning.NEXT: (TeleopEvents.TERMINATE_EPISODE,),
    Meaning.RERECORD: (TeleopEvents.TERMINATE_EPISODE, TeleopEvents.RERECORD_EPISODE),
    Meaning.DISCARD: (TeleopEvents.TERMINATE_EPISODE, TeleopEvents.RERECORD_EPISODE),
}
_ENDINGS = (TeleopEvents.TERMINATE_EPISODE, TeleopEvents.SUCCESS, TeleopEvents.RERECORD_EPISODE)

# Constants of `ToolSteps`
_OPENS, _CLOSES = 0.0, 2.0  # LeRobot's values of an opening gripper (_OPENS) and a closing one (_CLOSES)
_HALF = 0.5  # opening below which a trigger counts as squeezed, and a gripper as closed
_AFRESH_S = 0.5  # pause between actions after which steps restart, s: follower and leader may have moved


class MotorBus:
    """Motors of one follower arm, with the names and units of its features.

    arms: arms of the follower. send: `send_action` of the follower.
    """

    def __init__(self, arms: ArmGroup, send: Callable[[Mapping[str, Any]], Mapping[str, float]]):
        self._arms, self._send = arms, send

    @property
    def motors(self) -> dict[str, int]:
        """Index of each motor's value in an action. Raises ConfigError: the RL stack cannot drive this follower."""
        arms = self._arms
        if len(arms.sides) != 1 or not arms.sides[0].has_gripper:
            raise ConfigError(f"{arms.device}: LeRobot's RL stack drives one arm with a gripper; use yam_follower")
        if not (arms.scale != 1.0).any():
            raise ConfigError(f"{arms.device}: LeRobot's RL stack computes in degrees; set use_degrees: true")
        return {name: place for place, name in enumerate(arms.motors)}

    def sync_read(self, register: str) -> dict[str, float]:
        """Read the register Present_Position of each motor: degrees, the gripper 0 closed … 1 open.

        Raises:
            ActionError: `register` is not Present_Position, the only one that can be read.
            YamError: the arm is silent or in fault.
        """
        self._check(register, "Present_Position", "leave add_current_to_observation off")
        (state,) = self._arms.observe()
        values = self._arms.action(np.array(state.positions))
        return {key.removesuffix(".pos"): value for key, value in values.items()}

    def sync_write(self, register: str, values: Mapping[str, Any]) -> None:
        """Move the arm to the values of Goal_Position, and wait until its set-point has arrived or stopped moving.

        LeRobot writes the path to its reset pose within 0.75 s and then nothing for seconds. Without the wait a slower
        arm would stop and hold halfway.

        Raises:
            ActionError: `register` is not Goal_Position, or motors or values are wrong; nothing was sent.
            YamError: the arm is silent or in fault.
        """
        self._check(register, "Goal_Position", "it is the only one that can be written")
        action = {f"{name}.pos": float(value) for name, value in values.items()}
        clock = self._arms.clock
        before, moved_s = self._arms.held(), clock.now()
        while clock.now() - moved_s < _BLOCKED_S:
            sent, now = self._arms.vector(self._send(action)), self._arms.held()
            if np.abs(sent - now).max() < _THERE:
                return
            if np.abs(now - before).max() > _MOVES:
                before, moved_s = now, clock.now()
            clock.sleep(_TICK_S)

    def _check(self, register: str, known: str, remedy: str) -> None:
        if register != known:
            raise ActionError(f"{self._arms.device}: its motors have {known}, but no {register}; {remedy}")


class TeleopEventWatch:
    """Monitor of the handles and gates of a leader device, from the first call on.

    A person intervenes between a press of the button `correct` and its next press, or a press of `go_on`; and while all
    leaders with a gate are lifted.

    Args:
        meanings: name of a button, such as left_bottom → its meaning.
        read: callback that returns prefix → newest state of the arm.
    """

    def __init__(self, meanings: Mapping[str, Meaning], read: Callable[[], Mapping[str, ArmState]]):
        self._meanings, self._read = meanings, read
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._ends = threading.Event()
        self._corrects = False
        self._came: set[TeleopEvents] = set()
        self._asked_s = -math.inf

    def intervenes(self) -> bool:
        """Return whether a person drives. Raises YamError: an arm is silent."""
        self._start()
        states = list(self._read().values())
        if any(state.mode is Mode.STOPPED for state in states):
            return False
        gates = [state.gate for state in states if state.gate]
        return self._corrects or bool(gates) and all(gate in LIFTED for gate in gates)

    def take(self) -> dict[TeleopEvents, bool]:
        """Return the events since the last call, each once, and whether a person drives.

        Events after a pause of half a second between calls belong to an episode that has ended, and are discarded.

        Raises:
            YamError: see `intervenes`.
        """
        intervenes, now_s = self.intervenes(), time.monotonic()
        with self._lock:
            came, self._came = self._came, set()
        asked_s, self._asked_s = self._asked_s, now_s
        if came and now_s - asked_s > _RESET_S:
            logger.info("what was pressed while the arm was reset counts for nothing")
            came = set()
        return {TeleopEvents.IS_INTERVENTION: intervenes, **{event: event in came for event in _ENDINGS}}

    def stop(self) -> None:
        """Stop the monitor, and discard all events. Idempotent."""
        thread, self._thread = self._thread, None
        self._ends.set()
        if thread is not None:
            thread.join(_END_S)
        self._corrects, self._came = False, set()

    def _start(self) -> None:
        if self._thread is None and self._meanings:
            self._ends = threading.Event()
            self._thread = threading.Thread(target=self._run, args=(self._ends,), name="teleop events", daemon=True)
            self._thread.start()

    def _run(self, ends: threading.Event) -> None:
        presses = Presses()
        while not ends.wait(_PERIOD_S):
            try:
                pressed = presses.new(self._read())
            except YamError as error:  # arms off or loop ended, which is reported elsewhere
                logger.debug("no buttons: %s", error)
                continue
            for button in pressed:
                if button in self._meanings:
                    self._answer(button, self._meanings[button])

    def _answer(self, button: str, meaning: Meaning) -> None:
        if meaning in (Meaning.CORRECT, Meaning.GO_ON):
            self._corrects = meaning is Meaning.CORRECT and not self._corrects
            logger.info("button %s: %s", button, "a person intervenes" if self._corrects else "the policy drives")
        elif meaning in _EVENTS:
            with self._lock:
                self._came |= set(_EVENTS[meaning])
            logger.info("button %s: %s", button, meaning)
        else:
            logger.warning("button %s (%s): means nothing to LeRobot's RL stack", button, meaning)


class ToolSteps:
    """Keys and actions of one leader, as steps of the end effector (see the module's docstring).

    Args:
        arms: group with the leader's arm.
        models: profiles of the follower's arm.
        step_m: maximum step along an axis, `end_effector_step_sizes` of LeRobot's config.
        opening: callback that returns the target opening of the follower's gripper, 0 closed … 1 open.

    Raises:
        ConfigError: there are two leaders, or the follower has no gripper.
    """

    def __init__(self, arms: ArmGroup, models: Models, step_m: float, opening: Callable[[], float]):
        side = arms.sides[0]
        if len(arms.sides) != 1 or not side.joints or side.gripper_index is None:
            raise ConfigError(f"{arms.device}: action_space: delta is for one arm with a gripper, as is LeRobot's RL")
        if not step_m > 0.0:
            raise ConfigError(f"{arms.device}: step_m must be positive, not {step_m}")
        self.keys = [*STEPS, "gripper"]
        self._side, self._step_m, self._opening = side, step_m, opening
        from lerobot_robot_yam.arm.kinematics import YamKinematics  # mink takes a second to import

        self._kinematics = YamKinematics(*models[0])
        # (3,) m, position of the leader's end effector at the start, plus all steps
        self._anchor: np.ndarray | None = None
        self._closes = self._squeezed = False
        self._given_s = 0.0

    @property
    def features(self) -> dict[str, Any]:
        """Description of an action as in LeRobot's data sets."""
        names = {name: place for place, name in enumerate(self.keys)}
        return {"dtype": "float32", "shape": (len(names),), "names": names}

    def begin(self) -> None:
        """Restart the steps: the follower is no longer moved by this leader."""
        self._anchor = None

    def action(self, vector: np.ndarray) -> dict[str, float]:
        """Return the step for a leader whose joints and trigger opening are `vector` (n + 1,), rad and 0 … 1.

        After `begin`, or half a second without a call, the step is zero and the gripper keeps its direction.
        """
        now_s, tool = time.monotonic(), self._kinematics.fk(vector[self._side.slice])[:3, 3]
        squeezed = bool(vector[self._side.gripper_index] < _HALF)
        if self._anchor is None or now_s - self._given_s > _AFRESH_S:
            self._anchor, self._closes = tool, self._opening() < _HALF
        elif squeezed is not self._squeezed:
            self._closes = squeezed
        self._squeezed, self._given_s = squeezed, now_s
        step = np.clip((tool - self._anchor) / self._step_m, -1.0, 1.0)
        self._anchor = self._anchor + step * self._step_m
        return dict(zip(self.keys, [*step.tolist(), _CLOSES if self._closes else _OPENS], strict=True))
