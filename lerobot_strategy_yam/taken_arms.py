"""Which arms a person has taken over, and the action of a tick that is made of the policy's and the person's.

An arm that is given back blends from where the person has left it:

    action = left + s (policy − left),  s = (1 − cos(π t / T)) / 2

Actions are LeRobot's: numbers by key. The keys of an arm begin with its prefix.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence

Action = dict[str, float]


class TakenArms:
    """Arms of one robot that a person has taken over, and the action of all.

    Args:
        prefixes: prefix of each arm: "" for a single arm, "left_" and "right_".
        hand_back_s: T; 0: no blend.

    Attributes:
        taken: prefixes of the arms that a person drives.
    """

    def __init__(self, prefixes: Sequence[str], hand_back_s: float):
        self._prefixes, self._hand_back_s = prefixes, hand_back_s
        self.taken: set[str] = set()
        self._last: Action = {}
        self._left: dict[str, Action] = {}  # by prefix, of the arms that blend
        self._since_s: dict[str, float] = {}  # when the policy said something for them first

    @property
    def all_taken(self) -> bool:
        """Whether nothing is left to the policy."""
        return len(self.taken) == len(self._prefixes)

    def take(self, prefix: str) -> None:
        """The person drives this arm from the next action on."""
        self.taken.add(prefix)
        self._left.pop(prefix, None)

    def give_back(self, prefix: str) -> None:
        """The policy drives this arm from the next action on."""
        self.taken.discard(prefix)
        self._left[prefix] = self._of(prefix, self._last)
        self._since_s.pop(prefix, None)

    def action(self, now: float, policy: Mapping[str, float] | None, person: Mapping[str, float] | None) -> Action:
        """What all arms are asked to do; an arm whose driver says nothing is asked to stay. Empty before the first.

        Args:
            now: s.
            policy: None: it has nothing to say.
            person: the leaders' action; None: no arm is taken.
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
        """Something else has moved all arms meanwhile, to this action: blend from there."""
        self._last = dict(action)
        for prefix in self._prefixes:
            self.give_back(prefix)

    @staticmethod
    def _of(prefix: str, action: Mapping[str, float]) -> Action:
        return {key: float(value) for key, value in action.items() if key.startswith(prefix)}


class WayBack:
    """The last actions, and the way back along them.

    Args:
        count: of actions that are kept.
    """

    def __init__(self, count: int):
        self._actions: deque[Action] = deque(maxlen=max(count, 1))

    def went(self, action: Action) -> None:
        """The arms were asked for this."""
        self._actions.append(action)

    def back(self) -> Action | None:
        """The action before; None: it is at its end."""
        return self._actions.pop() if self._actions else None
