"""What yam-doctor finds wrong with the arms of a new rig, and the commands of ours that repair it, run here."""

import re
import shlex
import subprocess
import sys
from collections.abc import Callable

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.lib.new_rig.rig_plan import RigPlan
from lerobot_robot_yam.doctor.check_channel import examine_channel
from lerobot_robot_yam.doctor.kit.findings import Finding, Severity, empty_report
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, Target

_REPAIRS = {"yam-motors timeout": "motors", "yam-handle zero": "handle", "yam-handle report": "handle"}
_COMMAND = re.compile(rf"(?:{'|'.join(_REPAIRS)})[^(;]*")
_ONE_MOTOR = re.compile(r" --motor \d+")


def inspect_rig(plan: RigPlan, say: Callable[[str], None]) -> list[Finding]:
    """Problems and warnings of the arms with motors. Asks only; energises nothing."""
    report = empty_report()
    for arm in [*plan.followers.values(), *plan.leaders.values()]:
        options = {key: value for key, value in arm.options.items() if key in ArmConfig.__dataclass_fields__}
        if "kind" not in arm.options:
            target = Target(ArmConfig(**{"name": arm.found.channel, "gripper": LEADER_GRIPPER, **options}))
            examine_channel(target, None, 0, report, say)
    found = [finding for section in report.values() for finding in section.findings]
    return [finding for finding in found if finding.severity is not Severity.NOTE]


def repairs_of(findings: list[Finding]) -> dict[str, list[Finding]]:
    """Commands of ours that repair findings, each with these; of several motors of an arm, one command for all."""
    commands: dict[str, list[Finding]] = {}
    for finding in findings:
        if (match := _COMMAND.search(finding.remedy)) is not None:
            commands.setdefault(_ONE_MOTOR.sub("", match[0]).strip(), []).append(finding)
    return commands


def run_repair(command: str, sure: bool) -> bool:
    """Run a command at this terminal, where it asks for itself; returns whether it succeeded."""
    words = shlex.split(command)
    program = [sys.executable, "-m", f"lerobot_robot_yam.commands.{_REPAIRS[' '.join(words[:2])]}"]
    yes = ["--yes"] if sure and words[1] != "report" else []
    return subprocess.run([*program, *words[1:], *yes], check=False).returncode == 0
