"""yam-estop            latch the emergency stop: followers hold and leaders float, BOTH STILL ENERGISED; no
                     other arm is energised
yam-estop release    let arms move again, each from where it is, with its next target; LANDS at once those whose session
                     has ended since
yam-estop status     say whether it is latched, by whom and why; exit status 1 if it is

yam-estop --host 192.168.1.20          latch that of another computer's arms; with release and status, too

Without --host the command reaches all arms that this user drives on this machine, from any shell; called by root, the
arms of every user. The output names the running sessions that hear the stop. If no session hears it, an arm may go on
moving, and a warning in capitals says so; the exit status stays 0, since no session that starts later energises its
arms. Exit status 1: some arms could not be reached.
"""

import argparse
import contextlib
import getpass
import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from platform import node

from lerobot_robot_yam.commands.lib.command_line import command_parser
from lerobot_robot_yam.commands.lib.host_option import add_host_arguments, ask_host
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.runtime_files import ENV_RUNTIME_DIR, runtime_dir, runtime_dirs, sessions

_UNHEARD = (
    "NO SESSION RUNS HERE THAT HEARS IT: if an arm moves, switch its power off. It is driven by another "
    f"user ({as_root('yam-estop')}), in a container, with another {ENV_RUNTIME_DIR}, or by other software. "
    "Latched all the same: no session starts\n"
)
_NOT = {"latch": "NOT STOPPED", "release": "NOT RELEASED", "status": "NOT KNOWN"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-estop`; return its exit status."""
    parser = command_parser("yam-estop", __doc__)
    parser.add_argument("action", nargs="?", choices=("latch", "release", "status"), default="latch")
    parser.add_argument("--why", default="yam-estop", help="the reason, for others to read")
    parser.add_argument("--json", action="store_true", help="answer in JSON")
    add_host_arguments(parser)
    options = parser.parse_args(arguments)
    return _here(options) if options.arms_host is None else _on_host(options)


def _here(options: argparse.Namespace) -> int:
    """Latch, release or show the emergency stops of this computer; return the exit status."""
    action = options.action
    stops = [EmergencyStop(directory) for directory in _directories(action)]
    before = {stop.directory: stop.reason() for stop in stops if stop.latched and action == "release"}
    missed = _act(stops, action, options.why)
    reached = [stop for stop in stops if stop.directory not in missed]
    latched = [stop for stop in reached if stop.latched]
    heard = [(stop.directory, key, process) for stop in latched for key, process in sessions(stop.directory).items()]
    if options.json:
        answer = {
            "latched": bool(latched),
            "reason": latched[0].reason() if latched else "",
            "directories": [str(stop.directory) for stop in latched],
            "heard_by": [{"directory": str(d), "channel": key, "process": process} for d, key, process in heard],
            "missed": {str(directory): str(error) for directory, error in missed.items()},
        }
        sys.stdout.write(json.dumps(answer) + "\n")
    elif reached:
        _say(reached, before)
        if latched:
            sys.stdout.write(f"heard by {_named((key, pid) for _, key, pid in heard)}\n" if heard else _UNHEARD)
    if missed and not reached and action != "status":
        reasons = "; ".join(map(str, missed.values()))
        sys.stderr.write(f"yam-estop: NOTHING IS STOPPED OR RELEASED: {reasons}; switch the arms' power off\n")
    else:
        for directory, error in missed.items():
            sys.stderr.write(
                f"yam-estop: {_NOT[action]}: arms that are driven by way of {directory}, if any ({error.strerror}); "
                f"their user can, and root: {as_root(f'yam-estop {action}')}\n"
            )
    if action == "status":
        return int(bool(latched))
    # Latching succeeds only if it reaches the arms of all users; releasing, if it reaches the calling user's arms.
    return int(bool(missed) if action == "latch" else stops[0].directory in missed)


def _directories(action: str) -> list[Path]:
    """Return the runtime directories to act in. "latch" creates the user's own, so that later sessions see the stop."""
    found = runtime_dirs()
    if os.getuid() == 0 and len(found) > 1 and not found[0].exists():
        return found[1:]  # root drives no arm, and other users could not read files in root's directory
    if action == "latch":
        with contextlib.suppress(ConfigError):  # an unusable directory is reported when the stop is written
            runtime_dir()
    return found


def _act(stops: Sequence[EmergencyStop], action: str, why: str) -> dict[Path, OSError]:
    """Latch, release or look up all stops; return directory -> error of each stop that cannot be changed or read."""
    missed = {}
    for stop in stops:
        try:
            if action == "latch":
                stop.latch(why)
            elif action == "release":
                stop.release()
            elif stop.directory.exists():
                os.listdir(stop.directory)
        except OSError as error:
            missed[stop.directory] = error
    return missed


def _say(reached: Sequence[EmergencyStop], released: Mapping[Path, str]) -> None:
    """Print for each directory whether its stop is latched and, after a release, which arms are driven."""
    for stop in reached:
        where = f" in {stop.directory}" if len(reached) > 1 else ""
        what = f"latched{where}: {stop.reason()}" if stop.latched else f"not latched{where}"
        if not stop.latched and stop.directory in released:
            what = f"released{where}; it was latched: {released[stop.directory]}"
            if driven := _named(sessions(stop.directory).items()):
                what += f"\ndriven: {driven}; arms of running sessions go on, those of ended ones land"
        sys.stdout.write(f"emergency stop {what}\n")


def _named(sessions: Iterable[tuple[str, str]]) -> str:
    return ", ".join(f"{key} (process {process})" for key, process in sessions)


def _on_host(options: argparse.Namespace) -> int:
    """Latch, release or show the emergency stop of the host that has the arms; return the exit status."""
    try:
        answer = ask_host(options, "estop", action=options.action, why=options.why, who=f"{getpass.getuser()}@{node()}")
    except YamError as error:
        sys.stderr.write(f"yam-estop: {_NOT[options.action]}: {error}; switch the arms' power off\n")
        return 1
    heard = answer["heard_by"]
    if options.json:
        fields = {"latched": answer["latched"], "reason": answer["reason"], "heard_by": heard}
        sys.stdout.write(json.dumps(fields) + "\n")
    else:
        what = f"latched: {answer['reason']}" if answer["latched"] else "not latched"
        by = f"; arms that hear it: {', '.join(heard) or 'none are driven'}" if answer["latched"] else ""
        sys.stdout.write(f"emergency stop of {options.arms_host} {what}{by}\n")
    return int(bool(answer["latched"])) if options.action == "status" else 0


if __name__ == "__main__":
    sys.exit(main())
