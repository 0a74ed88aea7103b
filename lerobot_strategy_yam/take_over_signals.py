"""What the person asks of the strategy: by buttons and gates of the leaders, and by keys."""

from collections import deque
from enum import StrEnum
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning, Situation
from lerobot_robot_yam.face.operator_keys.auto_episodes import LIFTED
from lerobot_robot_yam.face.operator_keys.handle_buttons import RisingEdges, buttons_of
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_strategy_yam.config_yam_dagger import YamDaggerStrategyConfig
from lerobot_teleoperator_yam.leader_options import BUTTON_OPTIONS
from lerobot_teleoperator_yam.yam_leader import LeaderBase


class Wish(StrEnum):
    """What a person wishes, beside taking arms over."""

    KEEP = "keep"  # end the episode and save it
    DISCARD = "discard"  # drop the episode
    REWIND = "rewind"
    STOP = "stop"


_KEYS = {"n": Wish.KEEP, "x": Wish.DISCARD, "b": Wish.REWIND, "esc": Wish.STOP}
_ARM_KEYS = {"space": ("", "left_", "right_"), "l": ("left_",), "r": ("right_",)}
_ASKED = {  # by a page: the key, and what it does
    Meaning.CORRECT: ("space", "takes all arms over, or gives them back"),
    Meaning.NEXT: ("n", "ends the episode, and saves it"),
    Meaning.DISCARD: ("x", "drops the episode"),
    Meaning.STOP: ("esc", "ends the command"),
}
HELP = "space=take over or give back all arms, l/r=the left or right one, n=save, x=discard, b=back, ESC=stop"


class TakeOverSignals:
    """Signals from these leaders and the keyboard. Keys may come from any thread.

    Args:
        leaders: LeRobot's teleoperator.
        config: says which button does what.

    Attributes:
        prefixes: prefix of each arm.

    Raises:
        ConfigError: the teleoperator is no YAM leader that leads a follower, or a button has two meanings.
    """

    def __init__(self, leaders: Any, config: YamDaggerStrategyConfig):
        if not isinstance(leaders, LeaderBase):
            raise ConfigError(f"yam_dagger needs YAM leaders, not {leaders}; use --strategy.type=dagger")
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
        self._edges = RisingEdges()
        self._toggled, self._opened = set[str](), set[str]()

    def key(self, name: str) -> None:
        """A key, as LeRobot's listeners call it."""
        self._keys.append(name)

    def ask(self, press: Press) -> None:
        """Do what a page asks for, see `requests.Doer`."""
        if press.meaning in _ASKED:
            self.key(_ASKED[press.meaning][0])

    def offers(self, now: Situation, first: int) -> dict[str, str]:
        """Say in words what can be asked for now, see `requests.Doer`."""
        return {meaning.value: words for meaning, (_, words) in _ASKED.items()}

    def look(self) -> tuple[set[str], set[Wish]]:
        """Prefixes of the arms that the person wants to drive, and what else was asked for since the last look."""
        wishes, states = set[Wish](), self._leaders.arm_states()
        pressed = self._edges.pressed(buttons_of(states))
        for prefix in states:
            if f"{prefix}{self._config.take_over_button}" in pressed and prefix not in self._gated:
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
        return self._toggled | self._opened, wishes

    def give_all_back(self) -> set[str]:
        """Forget which arms were taken over by button or key; those that a gate has taken over."""
        self._toggled.clear()
        return set(self._opened)
