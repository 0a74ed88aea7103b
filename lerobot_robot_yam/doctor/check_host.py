"""Check of this computer: real-time scheduling, memory locking, CPUs, sleep states and the emergency stop."""

import os
import platform
import resource
import subprocess
import sys
from pathlib import Path

from lerobot_robot_yam.control.process.control_process import RT_PRIORITY
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.other_plugins import mixture, overwritten
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.sysfs import SYSFS, text_of

_RIGHTS = f"{as_root('yam-setup-can --rights')} (then log in again)"
_STATES = Path("/sys/power/state")  # sleep states that the kernel offers, such as "freeze mem disk"
_SUSPEND = Path("/etc/systemd/system/suspend.target")
_CPUS_MIN = 4  # minimum number of CPUs: for control loop, LeRobot, video encoder and system
# Program for a subprocess, since a process that has requested real-time scheduling keeps it.
_ASK = (
    "import sys; from lerobot_robot_yam.system.realtime import request_realtime; "
    f"sys.stdout.write(request_realtime({RT_PRIORITY}))"
)
_ASK_TIMEOUT_S = 30.0


def check_host(sysfs: Path, section: Section) -> None:
    """Request the control loop's scheduling and memory in a short-lived process, and report what was granted."""
    granted = _granted()
    cpus = len(os.sched_getaffinity(0))
    governor = text_of(sysfs / "devices/system/cpu/cpu0/cpufreq/scaling_governor")
    facts = {
        "granted to the control loop": granted,
        "RLIMIT_RTPRIO": _limit(resource.RLIMIT_RTPRIO),
        "RLIMIT_MEMLOCK": _limit(resource.RLIMIT_MEMLOCK),
        "kernel": platform.release(),
        "CPUs": cpus,
        "CPU governor": governor,
    }
    section.rows += [{"what": key, "value": value} for key, value in facts.items()]
    where = "this computer"
    if granted is None:
        section.warn(where, "what the kernel grants is unknown: asking for it failed", _RIGHTS)
    elif "SCHED_FIFO" not in granted:
        short = "slices" in granted  # short time slices are as good as SCHED_FIFO beside one busy process
        what = f"the control loop gets {granted}; SCHED_FIFO is not permitted"
        (section.note if short else section.warn)(where, what, _RIGHTS)
    if granted is not None and "memory not locked" in granted:
        section.warn(where, "memory cannot be locked: the control loop may wait for the disk", _RIGHTS)
    if cpus < _CPUS_MIN:
        what = f"{cpus} CPUs for control loop, LeRobot, video encoder and cameras"
        section.note(where, what, "record fewer or smaller pictures, or use a computer with more CPUs")
    if governor == "powersave":
        what = "the CPU governor is powersave: wake-ups may be late"
        section.note(where, what, "sudo cpupower frequency-set -g performance")
    if sysfs == SYSFS and _can_sleep():
        what = "it can go to sleep, and a desktop does so while arms are led by hand: asleep it lets them fall"
        section.warn(where, what, "sudo systemctl mask sleep.target suspend.target hibernate.target")
    if overwritten():
        section.problem(where, *mixture())
    stop = EmergencyStop()
    if sources := stop.sources():
        why = "; ".join(sources.values())
        what = f"the emergency stop is latched ({why}): no session starts, running arms stay energised"
        section.problem(where, what, f"look at the arms, then: yam-estop release {' '.join(sources)}")


def _granted() -> str | None:
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", _ASK], capture_output=True, text=True, timeout=_ASK_TIMEOUT_S, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None


def _can_sleep() -> bool:
    """Return whether this computer can be suspended: it has a sleep state, and systemd's target is not masked."""
    return bool((text_of(_STATES) or "").split()) and _SUSPEND.resolve() != Path("/dev/null")


def _limit(which: int) -> str:
    soft, _ = resource.getrlimit(which)
    return "unlimited" if soft == resource.RLIM_INFINITY else str(soft)
