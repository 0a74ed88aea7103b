"""Take-over of arms: a person's requests by handles and keys, and the action combined from policy and person.

The action of an arm that is given back blends from the pose in which the person left the arm:

    action = left + s (policy − left),  s = (1 − cos(π t / T)) / 2

Actions are LeRobot's: numbers by key. The keys of an arm begin with its prefix.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.drive_options import DriveOptions
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning, Situation
from lerobot_robot_yam.face.operator_keys.auto_episodes import LIFTED
from lerobot_robot_yam.face.operator_keys.handle_buttons import BUTTONS, Presses
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_robot_yam.state.modes import Mode
from lerobot_strategy_yam.config_yam_dagger import YamDaggerStrategyConfig
from lerobot_teleoperator_yam.leader_options import BUTTON_OPTIONS
from lerobot_teleoperator_yam.yam_leader import LeaderBase

Action = dict[str, float]
_ARM_KEYS = {"space": ("", "left_", "right_"), "l": ("left_",), "r": ("right_",)}
_ASKED = {  # request from a page → (equivalent key, effect of the key)
    Meaning.CORRECT: ("space", "takes all arms over, or gives them back"),
    Meaning.NEXT: ("n", "ends the episode, and saves it"),
    Meaning.DISCARD: ("x", "drops the episode"),
    Meaning.STOP: ("esc", "ends the command"),
}
HELP = "space=take over or give back all arms, l/r=the left or right one, n=save, x=discard, b=back, ESC=stop"


class TakenArms:
    """Arms of one robot that a person has taken over, and the combined action of all arms.

    Args:
        prefixes: prefix of each arm: "" for a single arm, "left_" and "right_".
        hand_back_s: duration T of a blend, s; 0: no blend.

    Attributes:
        taken: prefixes of the arms that a person drives.
    """

    def __init__(self, prefixes: Sequence[str], hand_back_s: float):
        self._prefixes, self._hand_back_s = prefixes, hand_back_s
        self.taken: set[str] = set()
        self._last: Action = {}
        self._left: dict[str, Action] = {}  # prefix → action at which the person left the arm
        self._since_s: dict[str, float] = {}  # prefix → time of the policy's first action after the person left the arm

    @property
    def all_taken(self) -> bool:
        """Whether the person drives all arms."""
        return len(self.taken) == len(self._prefixes)

    def take(self, prefix: str) -> None:
        """Let the person drive this arm from the next action on."""
        self.taken.add(prefix)
        self._left.pop(prefix, None)

    def give_back(self, prefix: str) -> None:
        """Let the policy drive this arm from the next action on."""
        self.taken.discard(prefix)
        self._left[prefix] = self._of(prefix, self._last)
        self._since_s.pop(prefix, None)

    def action(self, now: float, policy: Mapping[str, float] | None, person: Mapping[str, float] | None) -> Action:
        """Combine the actions of all arms. An arm whose driver has no action stays. Empty before the first action.

        Args:
            now: current time, s.
            policy: action of the policy, if it has one.
            person: action of the leaders; None: no arm is taken.
        """
        action: Action = {}
        for prefix in self._prefixes:
            if prefix in self.taken and person is not None:
                asked = self._of(prefix, person)
            elif prefix not in self.taken and policy is not None:
                asked = self._blended(now, prefix, self._of(prefix, policy))
            else:
                asked = self._of(prefix, self._last)
            if not asked:
                return {}
            action |= asked
        self._last = action
        return dict(action)

    def _blended(self, now: float, prefix: str, asked: Action) -> Action:
        left = self._left.get(prefix)
        if not left:
            return asked
        t = now - self._since_s.setdefault(prefix, now)
        if t >= self._hand_back_s:
            del self._left[prefix]
            return asked
        share = 0.5 - 0.5 * math.cos(math.pi * t / self._hand_back_s)
        return {key: left[key] + share * (value - left[key]) for key, value in asked.items()}

    def resume(self, action: Action) -> None:
        """Continue from `action`, to which something else has moved all arms in the meantime."""
        self._last = dict(action)
        for prefix in self._prefixes:
            self.give_back(prefix)

    @staticmethod
    def _of(prefix: str, action: Mapping[str, float]) -> Action:
        return {key: float(value) for key, value in action.items() if key.startswith(prefix)}


class Wish(StrEnum):
    """Request from a person other than a take-over."""

    KEEP = "keep"  # end the episode and save it
    DISCARD = "discard"  # drop the episode
    REWIND = "rewind"
    STOP = "stop"


_KEYS = {"n": Wish.KEEP, "x": Wish.DISCARD, "b": Wish.REWIND, "esc": Wish.STOP}


class TakeOverSignals:
    """Requests from a person, by leaders and keyboard. Keys may come from any thread.

    Args:
        leaders: LeRobot's teleoperator.
        config: options of the strategy, which assign buttons.

    Attributes:
        prefixes: prefix of each arm.
        pressed: prefixes of the arms that a press has taken over since the call before the last `look`. Their followers
            obey the person since the press.

    Raises:
        ConfigError: the teleoperator is no YAM leader with a follower, or drives a base; or a button has two meanings.
    """

    def __init__(self, leaders: Any, config: YamDaggerStrategyConfig):
        if not isinstance(leaders, LeaderBase):
            raise ConfigError(f"yam_dagger needs YAM leaders, not {leaders}; use --strategy.type=dagger")
        if isinstance(leaders.config, DriveOptions):
            raise ConfigError(f"yam_dagger takes over arms, not the base of {leaders}; use --strategy.type=dagger")
        self._leaders, self._config = leaders, config
        arms = leaders.config.arms()
        self.prefixes = list(arms)
        self._gated = {prefix for prefix, arm in arms.items() if arm.gate != "always"}
        if leaders.config.buttons:
            raise ConfigError("yam_dagger reads the handles itself; leave the teleoperator's option buttons away")
        for prefix, arm in arms.items():
            if arm.follower is None:
                what = f"{prefix.replace('_', ' ')}leader"
                raise ConfigError(f"yam_dagger: {what}: set follower to its follower's channel; a take-over would jump")
            ours = {config.rewind_button, None if prefix in self._gated else config.take_over_button} - {None}
            for name in BUTTON_OPTIONS:
                if (button := getattr(arm, name, None)) in ours:
                    raise ConfigError(
                        f"button {prefix}{button} has two meanings: {name}, and yam_dagger's; give it one"
                    )
        self._keys: deque[str] = deque()
        self._presses = Presses()
        self._toggled, self._opened = set[str](), set[str]()
        # prefix → index of the button that takes the arm over; none for a gate that a lift opens
        given = {
            prefix: arm.gate_button if prefix in self._gated else config.take_over_button
            for prefix, arm in arms.items()
        }
        self._buttons = {prefix: BUTTONS.index(button) for prefix, button in given.items() if button is not None}
        self._wanted, self.pressed = set[str](), set[str]()

    def key(self, name: str) -> None:
        """Store a key. LeRobot's listeners call `key`."""
        self._keys.append(name)

    def ask(self, press: Press) -> None:
        """Carry out a request from a page, see `requests.Doer`."""
        if press.meaning in _ASKED:
            self.key(_ASKED[press.meaning][0])

    def offers(self, now: Situation, first: int) -> dict[str, str]:
        """Describe what a page can currently request, see `requests.Doer`."""
        return {meaning.value: words for meaning, (_, words) in _ASKED.items()}

    def look(self) -> tuple[set[str], set[Wish]]:
        """Return the prefixes of the arms that the person wants to drive, and other requests since the last call."""
        wishes, states = set[Wish](), self._leaders.arm_states()
        pressed = self._presses.new(states)
        if any(state.mode is Mode.STOPPED for state in states.values()):
            pressed = []  # a hand that touches a stopped arm must not move it once the stop is released
        for prefix in states:
            presses = pressed.count(f"{prefix}{self._config.take_over_button}")
            if presses % 2 and prefix not in self._gated and self._config.take_over == "toggle":
                self._toggled ^= {prefix}
            if f"{prefix}{self._config.rewind_button}" in pressed:
                wishes.add(Wish.REWIND)
        while self._keys:
            name = self._keys.popleft()
            if name in _KEYS:
                wishes.add(_KEYS[name])
            arms = set(_ARM_KEYS.get(name, ())) & (states.keys() - self._gated)
            self._toggled = self._toggled - arms if arms <= self._toggled else self._toggled | arms
        self._opened = {prefix for prefix in self._gated if states[prefix].gate in LIFTED}
        held = set[str]()
        if self._config.take_over == "hold":
            held = {
                prefix
                for prefix, at in self._buttons.items()
                if prefix not in self._gated and states[prefix].buttons[at]
            }
        before, self._wanted = self._wanted, self._toggled | self._opened | held
        by_button = {prefix for prefix, at in self._buttons.items() if f"{prefix}{BUTTONS[at]}" in pressed}
        self.pressed = (self._wanted - before) & by_button
        free = self._buttons.keys() - self._wanted
        self._leaders.let_take_over({p: (self._buttons[p] + 1, states[p].presses[self._buttons[p]]) for p in free})
        return set(self._wanted), wishes

    def end(self) -> None:
        """Let no press take over an arm any more: the arms go back and land."""
        self._leaders.let_take_over({})

    def give_all_back(self) -> set[str]:
        """Give back arms taken over by button or key. Return the prefixes of arms taken over by a gate."""
        self._toggled.clear()
        return set(self._opened)
