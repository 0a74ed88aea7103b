"""Buttons of teaching handles: their meanings in the option `buttons`, and detection of presses."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning
from lerobot_robot_yam.state.arm_state import ArmState

BUTTONS = ("top", "bottom")  # names of a handle's buttons, in the order of the handle's report


_SETS: dict[str, dict[int, dict[Meaning, str]]] = {  # name of a set → number of arms → meaning → button
    "record": {
        1: {Meaning.NEXT: "bottom", Meaning.RERECORD: "top"},
        2: {
            Meaning.NEXT: "left_bottom",
            Meaning.FAILURE: "right_bottom",
            Meaning.RERECORD: "left_top",
            Meaning.STOP: "right_top",
        },
    },
    "dagger": {
        1: {Meaning.CORRECT: "bottom", Meaning.GO_ON: "top"},
        2: {
            Meaning.CORRECT: "left_bottom",
            Meaning.GO_ON: "right_bottom",
            Meaning.PAUSE: "left_top",
            Meaning.STOP: "right_top",
        },
    },
}
SETS = tuple(_SETS)


def button_meanings(given: Any, prefixes: Sequence[str], taken: Mapping[str, str]) -> dict[str, Meaning]:
    """Return button → meaning, for each button that has a meaning.

    Args:
        given: the option `buttons`: one of `SETS`, or a mapping meaning → button or list of buttons.
        prefixes: prefix of each arm with a handle: "" for a single arm, "left_", "right_".
        taken: button → name of the option that uses the button.

    Raises:
        ConfigError: a meaning or button does not exist, or a button has two meanings.
    """
    if given in (None, "", {}):
        return {}
    known = [f"{prefix}{button}" for prefix in prefixes for button in BUTTONS]
    if not known:
        raise ConfigError("buttons needs a teaching handle; no arm has one")
    meanings: dict[str, Meaning] = {}
    for word, buttons in _rows(given, prefixes).items():
        meaning = Meaning(_known(word, "meaning of a button", list(Meaning)))
        for button in [buttons] if isinstance(buttons, str) else buttons:
            name = _known(button, "button", known)
            if name in taken:
                raise ConfigError(f"button {name} has two meanings: {taken[name]} and {meaning}; give it one")
            if name in meanings:
                raise ConfigError(f"button {name} has two meanings: {meanings[name]} and {meaning}; give it one")
            meanings[name] = meaning
    return meanings


def _rows(given: Any, prefixes: Sequence[str]) -> Mapping[Any, Any]:
    if isinstance(given, str):
        rows = _SETS[_known(given, "set of buttons", SETS)][len(prefixes)]
        return {str(meaning): button if len(prefixes) > 1 else prefixes[0] + button for meaning, button in rows.items()}
    lists = isinstance(given, Mapping) and all(isinstance(value, str | list | tuple) for value in given.values())
    if not lists:
        raise ConfigError(
            f"buttons takes {' or '.join(SETS)}, or meanings with their buttons, such as {{next: left_bottom}}; "
            f"got {given!r}"
        )
    return given


def _known(word: Any, what: str, known: Iterable[str]) -> str:
    names = [str(name) for name in known]
    if word in names:
        return str(word)
    near = difflib.get_close_matches(str(word), names, 1)
    meant = f"did you mean {near[0]!r}? Known: " if near else "known: "
    raise ConfigError(f"no {what} {word!r}; {meant}{', '.join(names)}")


class RisingEdges:
    """Detector of presses of buttons that are held to act: a gamepad's, or a handle's drive button.

    A button that is down at first, or after its device was silent, has to be up before it counts as pressed.
    """

    def __init__(self) -> None:
        self._up: set[str] = set()  # buttons that were up at the last call

    def pressed(self, buttons: Mapping[str, bool | None]) -> list[str]:
        """Return the buttons pressed since the last call. buttons: name → whether down; None: the device is silent."""
        edges = [name for name, down in buttons.items() if down and name in self._up]
        self._up = {name for name, down in buttons.items() if down is False}
        return edges


class Presses:
    """Counter of the presses of handles' buttons, which the control loop has counted: none is missed between calls."""

    def __init__(self) -> None:
        self._counted: dict[str, int] = {}

    def new(self, states: Mapping[str, ArmState]) -> list[str]:
        """Return the names, such as left_bottom, of the buttons pressed since the last call, once for each press.

        states: prefix → state of the arm.
        """
        before = self._counted
        self._counted = {
            f"{prefix}{name}": count
            for prefix, state in states.items()
            for name, count in zip(BUTTONS, state.presses, strict=True)
        }
        return [name for name, count in self._counted.items() for _ in range(count - before.get(name, count))]
