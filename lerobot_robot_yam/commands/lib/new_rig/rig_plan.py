"""Plan of a new rig's file: the role of each arm, and the facts that only the user knows."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.commands.lib.arm_command import open_buses
from lerobot_robot_yam.commands.lib.dialogue import ask, tell, typed_line
from lerobot_robot_yam.commands.lib.new_rig.found_parts import (
    FOLLOWER,
    MOBILE_BASE,
    PASSIVE,
    RAIL,
    FoundArm,
    FoundCamera,
)
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER
from lerobot_robot_yam.errors import ConfigError, SetupError
from lerobot_robot_yam.setup.adapter_watch import WristWatch
from lerobot_robot_yam.system.paths import write_whole

SIDES = ("left", "right")
_SIDE_OF = {"l": "left", "left": "left", "r": "right", "right": "right"}
_PAYLOAD_KG = 3.0  # maximum accepted `payload_mass_kg`, kg
_NAME = re.compile(r"\w[\w-]*")
_LEAVE_OUT = "-"
_WRIST = "Turn its wrist by hand, a hand's width to and fro. Or: "
_FOREVER_S = 1e6

Check = Callable[[str], str]
"""Function that returns what is wrong with an answer; empty if the answer is valid."""


class Answers:
    """User's answers, stored in a file until setup is complete, so that an interrupted setup does not ask again.

    Args:
        path: file that stores the answers.
        sure: use the default answers without asking.

    Raises:
        SetupError: the answers of an earlier, interrupted setup cannot be read.
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

    def ask(self, question: str, usual: str, wrong: Check, get: Callable[[], str] | None = None) -> str:
        """Return the answer to a question; Enter alone gives the default answer `usual`.

        Args:
            get: function that obtains the answer; None: the user types the answer.

        Raises:
            ConfigError: the terminal was closed, or the default answer is wrong and `sure` forbids asking.
        """
        given = self._given.get(question)
        if given is not None and not wrong(given):  # a stored answer may be wrong now, if the rig has changed
            return given
        if self._sure:
            if complaint := wrong(usual):
                raise ConfigError(complaint)
            return usual
        get = get or (lambda: ask(f"{question} [{usual}]:") or usual)
        while complaint := wrong(answer := get()):
            tell(complaint)
        self._given[question] = answer
        write_whole(self._path, json.dumps(self._given, indent=1) + "\n")
        return answer

    def choose(self, question: str, among: Sequence[str], usual: Sequence[str] = ()) -> str:
        """Ask for one of the names in `among`; the default is the first name of `usual` that is in `among`."""
        if len(among) == 1:
            return among[0]
        likely = next((name for name in usual if name in among), among[0])
        return self.ask(f"{question} ({', '.join(among)})", likely, _none_of(among))

    def forget(self) -> None:
        """Delete the file of answers, once setup is complete."""
        self._path.unlink(missing_ok=True)


@dataclass(frozen=True)
class RigPlan:
    """Plan of a complete rig.

    Attributes:
        ident: LeRobot's id of the robot and the teleoperator.
        followers, leaders: side -> arm; the sides are "left" and "right", or "" if there is only one arm.
        cameras: camera's name in data sets -> LeRobot's config of the camera.
        base: the mobile base on which the arms ride.
        driver: type of the teleoperator that drives the base.
    """

    ident: str
    followers: dict[str, FoundArm]
    leaders: dict[str, FoundArm]
    cameras: dict[str, dict[str, Any]]
    base: FoundArm | None = None
    driver: str = ""


def plan_rig(arms: Sequence[FoundArm], cameras: Sequence[FoundCamera], answers: Answers) -> RigPlan:
    """Ask the user for everything that cannot be detected; return the plan.

    Raises:
        SetupError: LeRobot cannot drive this combination of arms.
        ConfigError: the terminal was closed.
        YamError: an arm that is to be identified by its wrist does not reply.
    """
    bases = [arm for arm in arms if arm.role == MOBILE_BASE]
    followers = [arm for arm in arms if arm.role == FOLLOWER]
    leaders = [arm for arm in arms if arm.role not in (FOLLOWER, MOBILE_BASE)]
    passive = [arm for arm in leaders if arm.role == PASSIVE]
    if bases and (len(bases) > 1 or len(followers) not in (0, 2) or passive):
        raise SetupError(
            f"{len(bases)} bases with {len(followers)} followers are no rig: LeRobot drives one base, alone or with "
            "two arms, and leaders with motors. Name the channels of the rig; found: "
            + ", ".join(arm.channel for arm in arms)
        )
    if (
        len(followers) not in ((0, 2) if bases else (1, 2))
        or len(leaders) not in (0, len(followers))
        or len(passive) not in (0, len(leaders))
    ):
        raise SetupError(
            f"{len(followers)} followers and {len(leaders)} leaders ({len(passive)} without motors) are no rig: "
            "LeRobot drives one follower or two, with as many leaders of one kind. Look for a missing one, or name the "
            f"channels that belong to the rig (--channel for each); found: {', '.join(arm.channel for arm in arms)}"
        )
    ident = answers.ask("Name of this rig, under which LeRobot keeps its calibration", "lab", _no_name)
    placed = _sides(followers, "follower", answers)
    leading = _sides(leaders, "leader", answers)
    planned: dict[str, FoundArm] = {}
    for side, arm in placed.items():
        planned[side] = _follower(arm, planned, answers)
    led = {side: _leader(arm, planned[side].options, answers) for side, arm in leading.items()}
    base, driver = (_base(bases[0], answers) if bases else None), ""
    if base is not None and not led:
        driver = answers.choose("What drives the base?", ("yam_gamepad", "yam_base_keys"))
    return RigPlan(ident, planned, led, _named(cameras, answers), base, driver)


def _sides(arms: Sequence[FoundArm], role: str, answers: Answers) -> dict[str, FoundArm]:
    """Return side -> arm, from the names of the channels, or else from the user's answer."""
    if len(arms) < 2:
        return dict(zip(("",), arms, strict=False))
    sides = {_SIDE_OF.get(re.split(r"[_-]", arm.channel)[-1], ""): arm for arm in arms}
    if set(sides) == set(SIDES):
        return {side: sides[side] for side in SIDES}
    channels = [arm.channel for arm in arms]
    question = f"Which of {' and '.join(channels)} is the left {role}, as you see it from behind the arms?"

    def shown() -> str:
        if any(arm.role == PASSIVE for arm in arms):
            tell(f"{question} Type its name:")
            return typed_line(_FOREVER_S) or ""
        with open_buses([arm.config for arm in arms]) as buses:
            watch = WristWatch(buses)
            tell(f"{question} {_WRIST}Type its name:")
            channel, line = watch.wait(typed_line, tell)
        return channel or line

    left = answers.ask(question, channels[0], _none_of(channels), shown)
    ordered = sorted(arms, key=lambda arm: arm.channel != left)
    tell(f"{left} is the left {role}, {ordered[1].channel} the right one")
    return dict(zip(SIDES, ordered, strict=True))


def _follower(arm: FoundArm, others: Mapping[str, FoundArm], answers: Answers) -> FoundArm:
    usual = [str(value) for other in others.values() for value in other.options.values()]
    options = _place(arm)
    options["arm"] = answers.choose(f"Which arm is on {arm.channel}? Read its label", arm.arms, usual)
    options["gripper"] = answers.choose(f"Which gripper is on {arm.channel}?", arm.grippers, usual)
    if not arm.virtual:
        question = f"Mass of what is fixed to the wrist on {arm.channel}, such as a camera, kg?"
        if mass := float(answers.ask(question, "0", _no_mass)):
            options["payload_mass_kg"] = mass
    return _weighed(arm, options)


def _leader(arm: FoundArm, follower: Mapping[str, Any], answers: Answers) -> FoundArm:
    led, options = follower["arm"], _place(arm)
    if arm.role == PASSIVE:
        options["kind"] = answers.choose(f"From which station is the leader on {arm.channel}?", tuple(JOINT_SIGNS))
        return replace(arm, options={**options, "arm": led, "ee_gripper": follower["gripper"]})
    options["arm"] = answers.choose(f"Which arm is on {arm.channel}? Read its label", arm.arms, [led])
    options |= {"gripper": LEADER_GRIPPER, "ee_gripper": follower["gripper"]}
    options |= {} if options["arm"] == led else {"follower_arm": led}
    return _weighed(arm, options)


def _base(base: FoundArm, answers: Answers) -> FoundArm:
    options = _place(base)
    if base.mark == RAIL:
        kinds = ("sim",) if base.virtual else ("gpio", "usb_gpio")
        rail = {"io": answers.choose("What reads the rail's switches and drives its brake?", kinds)}
        if rail["io"] == "usb_gpio":
            rail["port"] = answers.ask("Serial port of the rail's USB converter", "/dev/ttyUSB0", _no_port)
        options["rail"] = rail
    return replace(base, options=options)


def _place(arm: FoundArm) -> dict[str, Any]:
    """Return the options that locate an arm: channel, and on a virtual rig the interface and the rig's name."""
    where = {"interface": arm.config.interface, "can_options": {**arm.config.can_options}} if arm.virtual else {}
    return {"channel": arm.channel, **where}


def _weighed(arm: FoundArm, options: Mapping[str, Any]) -> FoundArm:
    """Return the planned arm; a virtual arm gets gravity factors of 1, since its weight is exactly the model's."""
    weight = {"gravity_factor": [1.0] * load_arm(options["arm"]).joint_count} if arm.virtual else {}
    return replace(arm, options={**options, **weight})


def _named(cameras: Sequence[FoundCamera], answers: Answers) -> dict[str, dict[str, Any]]:
    named: dict[str, dict[str, Any]] = {}

    def wrong(answer: str) -> str:
        if answer in named:
            return f"another camera is called {answer} already"
        return "" if answer == _LEAVE_OUT else _no_name(answer)

    for camera in cameras:
        usual = camera.name or f"camera_{len(named) + 1}"
        question = f"What is the camera {camera.label} called in data sets? ({_LEAVE_OUT} leaves it out)"
        name = answers.ask(question, usual, wrong)
        if name != _LEAVE_OUT:
            named[name] = camera.options
    return named


def _none_of(words: Sequence[str]) -> Check:
    return lambda answer: "" if answer in words else f"{answer!r} is none of {', '.join(words)}"


def _no_name(answer: str) -> str:
    return "" if _NAME.fullmatch(answer) else f"{answer!r} is no name: take letters, digits, _ and -"


def _no_port(answer: str) -> str:
    return "" if answer.startswith("/dev/") else f"{answer!r} is no serial port, such as /dev/ttyUSB0"


def _no_mass(answer: str) -> str:
    try:
        mass = float(answer)
    except ValueError:
        return f"{answer!r} is no number"
    return "" if 0.0 <= mass <= _PAYLOAD_KG else f"{answer} is not within 0 … {_PAYLOAD_KG:g}"
