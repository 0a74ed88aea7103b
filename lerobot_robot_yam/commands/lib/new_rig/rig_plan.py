"""A rig as it is going to be written: which arm is which, and what nobody but the person at it knows."""

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import can

from lerobot_robot_yam.arm.config import VIRTUAL
from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.commands.lib.arm_command import own_bus, tell
from lerobot_robot_yam.commands.lib.can_naming import typed_line
from lerobot_robot_yam.commands.lib.new_rig.answers import Answers, number, one_of
from lerobot_robot_yam.commands.lib.new_rig.found_parts import FOLLOWER, PASSIVE, FoundArm, FoundCamera, Place
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER
from lerobot_robot_yam.errors import ConfigError, SetupError
from lerobot_robot_yam.setup.adapter_watch import WristWatch

SIDES = ("left", "right")
_SIDE_OF = {"l": "left", "left": "left", "r": "right", "right": "right"}
_PAYLOAD_KG = 3.0  # of `payload_mass_kg`
_NAME = re.compile(r"\w[\w-]*")
_LEAVE_OUT = "-"
_WRIST = "Turn its wrist by hand, a hand's width to and fro. Or: "
_FOREVER_S = 1e6


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
    ident = answers.ask("Name of this rig, under which LeRobot keeps its calibration", "lab", _name)
    placed = _sides(place, followers, "follower", answers)
    leading = _sides(place, leaders, "leader", answers)
    planned: dict[str, PlannedArm] = {}
    for side, arm in placed.items():
        planned[side] = _follower(place, arm, planned, answers)
    led = {side: _leader(place, arm, planned[side], answers) for side, arm in leading.items()}
    return RigPlan(ident, planned, led, _named(cameras, answers))


def _name(answer: str) -> str:
    if not _NAME.fullmatch(answer):
        raise ConfigError(f"{answer!r} is no name: take letters, digits, _ and -")
    return answer


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
        with _buses(place, channels) as buses:
            watch = WristWatch(buses)
            tell(f"{question} {_WRIST}Type its name:")
            channel, line = watch.wait(typed_line, tell)
        return channel or line or ""

    left = answers.take(question, shown, one_of(*channels), channels[0])
    (right,) = [channel for channel in channels if channel != left]
    tell(f"{left} is the left {role}, {right} the right one")
    return {"left": by_channel[left], "right": by_channel[right]}


@contextlib.contextmanager
def _buses(place: Place, channels: Sequence[str]) -> Iterator[dict[str, can.BusABC]]:
    with contextlib.ExitStack() as stack:
        yield {channel: stack.enter_context(own_bus(place.config(channel))) for channel in channels}


def _follower(place: Place, arm: FoundArm, others: Mapping[str, PlannedArm], answers: Answers) -> PlannedArm:
    options, usual = _common(place, arm), [str(value) for other in others.values() for value in other.options.values()]
    options["arm"] = _choice(f"Which arm is on {arm.channel}? Read its label", arm.arms, usual, answers)
    options["gripper"] = _choice(f"Which gripper is on {arm.channel}?", arm.grippers, usual, answers)
    options |= _weight(place, options["arm"])
    if place.rig is None:
        question = f"Mass of what is fixed to the wrist on {arm.channel}, such as a camera, kg?"
        mass = float(answers.ask(question, "0", number(0.0, _PAYLOAD_KG)))
        options |= {"payload_mass_kg": mass} if mass else {}
    return PlannedArm(arm, options)


def _leader(place: Place, arm: FoundArm, follower: PlannedArm, answers: Answers) -> PlannedArm:
    led, gripper = follower.options["arm"], follower.options["gripper"]
    options = _common(place, arm)
    if arm.role == PASSIVE:
        question = f"From which station is the leader on {arm.channel}?"
        options["kind"] = _choice(question, tuple(JOINT_SIGNS), (), answers)
        return PlannedArm(arm, {**options, "arm": led, "ee_gripper": gripper})
    options["arm"] = _choice(f"Which arm is on {arm.channel}? Read its label", arm.arms, [led], answers)
    options |= {"gripper": LEADER_GRIPPER, "ee_gripper": gripper}
    options |= {} if options["arm"] == led else {"follower_arm": led}
    return PlannedArm(arm, {**options, **_weight(place, options["arm"])})


def _common(place: Place, arm: FoundArm) -> dict[str, Any]:
    where = {"interface": place.interface, "can_options": place.can_options} if place.interface == VIRTUAL else {}
    return {"channel": arm.channel, **where}


def _weight(place: Place, arm: str) -> dict[str, Any]:
    """The rig's arms weigh exactly what the model says; real ones do not quite."""
    return {"gravity_factor": [1.0] * load_arm(arm).joint_count} if place.interface == VIRTUAL else {}


def _choice(question: str, among: Sequence[str], usual: Sequence[str], answers: Answers) -> str:
    """One of several; by default the first of them that is usual, such as that of the arm before."""
    if len(among) == 1:
        return among[0]
    likely = next((name for name in usual if name in among), among[0])
    return answers.ask(f"{question} ({', '.join(among)})", likely, one_of(*among))


def _named(cameras: Sequence[FoundCamera], answers: Answers) -> dict[str, dict[str, Any]]:
    named: dict[str, dict[str, Any]] = {}

    def check(answer: str) -> str:
        if answer != _LEAVE_OUT and _name(answer) in named:
            raise ConfigError(f"another camera is called {answer} already")
        return answer

    for camera in cameras:
        usual = camera.name or f"camera_{len(named) + 1}"
        question = f"What is the camera {camera.label} called in data sets? ({_LEAVE_OUT} leaves it out)"
        name = answers.ask(question, usual, check)
        if name != _LEAVE_OUT:
            named[name] = camera.options
    return named
