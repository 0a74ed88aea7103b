"""Referees of an environment, which set up the scene before an episode, and judge the episode."""

import importlib
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from lerobot.utils.keyboard_input import create_key_listener

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning, Situation
from lerobot_robot_yam.face.operator_keys import requests
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations

logger = logging.getLogger(__name__)

_REMIND_S = 20.0  # interval between reminders while the referee waits for the operator's key, s
# the rig's time limit of a task, s: a day, because the environment ends episodes by their number of steps
_ENDLESS_S = 86_400.0
Judge = Callable[[Mapping[str, Any]], bool | None]
"""Function that judges an observation: True for success, False for failure, None for undecided."""


class Verdict(NamedTuple):
    """State of an episode: whether it is a success, and whether it is over."""

    success: bool = False
    over: bool = False


class Referee:
    """Referee that never ends an episode; base class of the other referees.

    scene: other referee that sets up the scene instead of this one, or None.
    """

    def __init__(self, scene: "Referee | None" = None):
        self._scene = scene

    def arrange(self, seed: int | None) -> None:
        """Set up the scene for an episode, while the arms are out of the way.

        Raises:
            YamError: the scene cannot be set up.
        """
        if self._scene is not None:
            self._scene.arrange(seed)

    def verdict(self, observation: Mapping[str, Any]) -> Verdict:
        """Judge the current episode by an observation."""
        return Verdict()

    def close(self) -> None:
        """Release the referee's resources. Idempotent."""
        if self._scene is not None:
            self._scene.close()


class RigReferee(Referee):
    """Referee for a virtual rig's own task: the rig sets up the scene and judges the episode.

    task: name of a task of the rig's scene.
    """

    def __init__(self, rig: RigOperations, task: str):
        super().__init__()
        self._rig, self._task = rig, task

    def arrange(self, seed: int | None) -> None:
        if seed is None:
            seed = int(np.random.default_rng().integers(2**31))
        self._rig.task(self._task, seed, _ENDLESS_S)

    def verdict(self, observation: Mapping[str, Any]) -> Verdict:
        state = self._rig.request("task_state")
        success = bool(state["success"])
        return Verdict(success, success or bool(state["failed"]))


_KEYS = {Meaning.NEXT: "space", Meaning.SUCCESS: "s", Meaning.FAILURE: "f"}  # request from a page → equivalent key


class OperatorReferee(Referee):
    """Person who sets up the scene and judges, by keys or on a page: space continues, s is success, f is failure.

    Raises:
        ConfigError: there is no keyboard.
    """

    def __init__(self, task: str, scene: Referee | None = None):
        super().__init__(scene)
        self._task = task
        self._key = ""
        self._pressed = threading.Event()
        self._arranges = False
        self._listener = create_key_listener(self._press, controls_help="space go on, s success, f failure")
        if self._listener is None:
            raise ConfigError(
                "env.success=operator needs a keyboard: run in a terminal, or let a callable judge (module:function)"
            )
        requests.join(self, first=True)

    def ask(self, press: Press) -> None:
        if press.meaning in self.offers(Situation(), 0):
            self._press(_KEYS[press.meaning])

    def offers(self, now: Situation, first: int) -> dict[str, str]:
        if self._arranges:
            return {Meaning.NEXT.value: "the scene is laid out: begins the episode"}
        return {label.value: f"the episode is a {label}, and ends" for label in (Meaning.SUCCESS, Meaning.FAILURE)}

    def _press(self, key: str) -> None:
        if key in ("space", "s", "f"):
            self._key = key
            self._pressed.set()

    def arrange(self, seed: int | None) -> None:
        if self._scene is not None:
            super().arrange(seed)
        else:
            logger.info("lay out the scene of '%s' (seed %s), then press space", self._task, seed)
            since_s = time.monotonic()
            self._pressed.clear()
            self._arranges = True
            while not self._pressed.wait(_REMIND_S) or self._key != "space":
                logger.info("waiting for space, since %.0f s; the arms hold", time.monotonic() - since_s)
                self._pressed.clear()
            self._arranges = False
        self._key = ""

    def verdict(self, observation: Mapping[str, Any]) -> Verdict:
        key, self._key = self._key, ""
        return Verdict(key == "s", key in ("s", "f"))

    def close(self) -> None:
        requests.leave(self)
        if self._listener is not None:
            self._listener.stop()
            self._listener = None


def find_judge(name: str) -> Judge:
    """Import the callable "module:function", see `YamEnvConfig.success`; the working directory is searched, too.

    Raises:
        ConfigError: the function does not exist.
    """
    module, _, function = name.partition(":")
    if (here := os.getcwd()) not in sys.path:  # a console script has its own folder in sys.path instead
        sys.path.append(here)
    try:
        judge: Judge = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"env.success: {name!r} is not 'rig', 'operator' or module:function ({error})") from error
    if not callable(judge):
        raise ConfigError(f"env.success: {name!r} is {judge!r} and cannot judge")
    return judge


class CallableReferee(Referee):
    def __init__(self, scene: Referee, judge: Judge):
        super().__init__(scene)
        self._judge = judge

    def verdict(self, observation: Mapping[str, Any]) -> Verdict:
        said = self._judge(observation)
        if said is not None and not isinstance(said, bool | np.bool_):
            raise RigError(f"the judge of env.success returned {said!r}; it has to be True, False or None")
        return Verdict(bool(said), said is not None)
