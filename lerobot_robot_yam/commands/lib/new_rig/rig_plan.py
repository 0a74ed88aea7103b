"""A rig as it is going to be written: which arm is which, and what nobody but the person at it knows."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import VIRTUAL
from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.commands.lib.arm_command import ask, tell
from lerobot_robot_yam.commands.lib.can_naming import open_buses, typed_line
from lerobot_robot_yam.commands.lib.new_rig.found_parts import FOLLOWER, PASSIVE, FoundArm, FoundCamera, Place
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER
from lerobot_robot_yam.errors import ConfigError, SetupError
from lerobot_robot_yam.setup.adapter_watch import WristWatch
from lerobot_robot_yam.system.paths import write_whole

SIDES = ("left", "right")
_SIDE_OF = {"l": "left", "left": "left", "r": "right", "right": "right"}
_PAYLOAD_KG = 3.0  # greatest `payload_mass_kg`
_NAME = re.compile(r"\w[\w-]*")
_LEAVE_OUT = "-"
_WRIST = "Turn its wrist by hand, a hand's width to and fro. Or: "
_FOREVER_S = 1e6

Check = Callable[[str], None]
"""Raises ConfigError: an answer does not do, and why."""


class Answers:
    """Asks questions, each once: answers are kept in a file until the set-up is done, so an interrupted one goes on.

    Args:
        path: file that keeps the answers.
        sure: do not ask; the usual answers are taken.

    Raises:
        SetupError: the file of an earlier set-up cannot be read.
    """

    def __init__(self, path: Path, sure: bool):
        self._path, self._sure = path, sure
        self._given: dict[str, str] = {}
        try:
            if path.exists():
                self._given = {str(key): str(value) for key, value in json.loads(path.read_text()).items()}
        except (OSError, ValueError, AttributeError) as error:
            raise SetupError(
                f"{path}, the answers of an interrupted set-up, is damaged: delete it ({error})"
            ) from error
        if self._given:
            tell(f"going on with the answers in {path}; delete it to be asked anew")

    def ask(self, question: str, usual: str, check: Check, get: Callable[[], str] | None = None) -> str:
        """The answer to a question; Enter takes the usual one.

        Args:
            get: gets the answer in another way than by typing it.

        Raises:
            ConfigError: the terminal has gone, or nobody may be asked and the usual answer does not do.
        """
        get = get or (lambda: ask(f"{question} [{usual}]:") or usual)
        if question in self._given:
            try:
                check(self._given[question])
                return self._given[question]
            except ConfigError:
                del self._given[question]  # things have changed since
        if self._sure:
            check(usual)
            return usual
        while True:
            answer = get()
            try:
                check(answer)
            except ConfigError as error:
                tell(str(error))
                continue
            self._given[question] = answer
            write_whole(self._path, json.dumps(self._given, indent=1) + "\n")
            return answer

    def choose(self, question: str, among: Sequence[str], usual: Sequence[str] = ()) -> str:
        """One of several; by default the first of them that is usual, such as that of the arm before."""
        if len(among) == 1:
            return among[0]
        likely = next((name for name in usual if name in among), among[0])
        return self.ask(f"{question} ({', '.join(among)})", likely, _one_of(among))

    def forget(self) -> None:
        """The set-up is done."""
        self._path.unlink(missing_ok=True)


@dataclass(frozen=True)
class PlannedArm:
    """One arm, and its options in the file."""

    found: FoundArm
    options: dict[str, Any]


@dataclass(frozen=True)
class RigPlan:
    """A whole rig.

    Attributes:
        ident: LeRobot's id of its robot and teleoperator.
        followers, leaders: by side, "left" and "right"; of a rig with one, by "".
        cameras: LeRobot's configs by their name in data sets.
    """

    ident: str
    followers: dict[str, PlannedArm]
    leaders: dict[str, PlannedArm] = field(default_factory=dict)
    cameras: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def passive(self) -> bool:
        """Whether its leaders have no motors."""
        return any(arm.found.role == PASSIVE for arm in self.leaders.values())


def plan_rig(place: Place, arms: Sequence[FoundArm], cameras: Sequence[FoundCamera], answers: Answers) -> RigPlan:
    """Ask what cannot be found out.

    Raises:
        SetupError: these arms are no rig that LeRobot drives.
        ConfigError: the terminal has gone.
        YamError: an arm whose wrist is to be turned does not answer.
    """
    followers = [arm for arm in arms if arm.role == FOLLOWER]
    leaders = [arm for arm in arms if arm.role != FOLLOWER]
    passive = [arm for arm in leaders if arm.role == PASSIVE]
    if len(followers) not in (1, 2) or len(leaders) not in (0, len(followers)) or len(passive) not in (0, len(leaders)):
        raise SetupError(
            f"{len(followers)} followers and {len(leaders)} leaders ({len(passive)} without motors) are no rig: "
            "LeRobot drives one follower or two, with as many leaders of one kind. Look for a missing one, or name the "
            f"channels that belong to the rig (--channel for each); found: {', '.join(arm.channel for arm in arms)}"
        )
    ident = answers.ask("Name of this rig, under which LeRobot keeps its calibration", "lab", _check_name)
    placed = _sides(place, followers, "follower", answers)
    leading = _sides(place, leaders, "leader", answers)
    planned: dict[str, PlannedArm] = {}
    for side, arm in placed.items():
        planned[side] = _follower(place, arm, planned, answers)
    led = {side: _leader(place, arm, planned[side].options, answers) for side, arm in leading.items()}
    return RigPlan(ident, planned, led, _named(cameras, answers))


def _sides(place: Place, arms: Sequence[FoundArm], role: str, answers: Answers) -> dict[str, FoundArm]:
    """The arms by side, as their channels are called, or as the person shows."""
    if len(arms) < 2:
        return dict(zip(("",), arms, strict=False))
    by_channel = {arm.channel: arm for arm in arms}
    sides = {_SIDE_OF.get(re.split(r"[_-]", channel)[-1], ""): arm for channel, arm in by_channel.items()}
    if set(sides) == set(SIDES):
        return {side: sides[side] for side in SIDES}
    channels = list(by_channel)
    question = f"Which of {' and '.join(channels)} is the left {role}, as you see it from behind the arms?"
    wrists = all(arm.role != PASSIVE for arm in arms)

    def shown() -> str:
        if not wrists:
            tell(f"{question} Type its name:")
            return typed_line(_FOREVER_S) or ""
        with open_buses([place.config(channel) for channel in channels]) as buses:
            watch = WristWatch(buses)
            tell(f"{question} {_WRIST}Type its name:")
            channel, line = watch.wait(typed_line, tell)
        return channel or line or ""

    left = answers.ask(question, channels[0], _one_of(channels), shown)
    (right,) = [channel for channel in channels if channel != left]
    tell(f"{left} is the left {role}, {right} the right one")
    return {"left": by_channel[left], "right": by_channel[right]}


def _follower(place: Place, arm: FoundArm, others: Mapping[str, PlannedArm], answers: Answers) -> PlannedArm:
    options, usual = place.options(arm), [str(value) for other in others.values() for value in other.options.values()]
    options["arm"] = answers.choose(f"Which arm is on {arm.channel}? Read its label", arm.arms, usual)
    options["gripper"] = answers.choose(f"Which gripper is on {arm.channel}?", arm.grippers, usual)
    options |= _weight(place, options["arm"])
    if place.rig is None:
        question = f"Mass of what is fixed to the wrist on {arm.channel}, such as a camera, kg?"
        mass = float(answers.ask(question, "0", _check_mass))
        options |= {"payload_mass_kg": mass} if mass else {}
    return PlannedArm(arm, options)


def _leader(place: Place, arm: FoundArm, follower: Mapping[str, Any], answers: Answers) -> PlannedArm:
    led, gripper = follower["arm"], follower["gripper"]
    options = place.options(arm)
    if arm.role == PASSIVE:
        options["kind"] = answers.choose(f"From which station is the leader on {arm.channel}?", tuple(JOINT_SIGNS))
        return PlannedArm(arm, {**options, "arm": led, "ee_gripper": gripper})
    options["arm"] = answers.choose(f"Which arm is on {arm.channel}? Read its label", arm.arms, [led])
    options |= {"gripper": LEADER_GRIPPER, "ee_gripper": gripper}
    options |= {} if options["arm"] == led else {"follower_arm": led}
    return PlannedArm(arm, {**options, **_weight(place, options["arm"])})


def _weight(place: Place, arm: str) -> dict[str, Any]:
    """The rig's arms weigh exactly what the model says; real ones do not quite."""
    return {"gravity_factor": [1.0] * load_arm(arm).joint_count} if place.interface == VIRTUAL else {}


def _named(cameras: Sequence[FoundCamera], answers: Answers) -> dict[str, dict[str, Any]]:
    named: dict[str, dict[str, Any]] = {}

    def check(answer: str) -> None:
        if answer != _LEAVE_OUT:
            _check_name(answer)
        if answer in named:
            raise ConfigError(f"another camera is called {answer} already")

    for camera in cameras:
        usual = camera.name or f"camera_{len(named) + 1}"
        question = f"What is the camera {camera.label} called in data sets? ({_LEAVE_OUT} leaves it out)"
        name = answers.ask(question, usual, check)
        if name != _LEAVE_OUT:
            named[name] = camera.options
    return named


def _one_of(words: Sequence[str]) -> Check:
    def check(answer: str) -> None:
        if answer not in words:
            raise ConfigError(f"{answer!r} is none of {', '.join(words)}")

    return check


def _check_name(answer: str) -> None:
    if not _NAME.fullmatch(answer):
        raise ConfigError(f"{answer!r} is no name: take letters, digits, _ and -")


def _check_mass(answer: str) -> None:
    try:
        mass = float(answer)
    except ValueError as error:
        raise ConfigError(f"{answer!r} is no number") from error
    if not 0.0 <= mass <= _PAYLOAD_KG:
        raise ConfigError(f"{answer} is not within 0 … {_PAYLOAD_KG:g}")
