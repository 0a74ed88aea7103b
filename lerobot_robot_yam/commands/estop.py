"""yam-estop                 latch the emergency stop: followers hold and leaders float, BOTH STILL ENERGISED; no
                          other arm is energised
yam-estop release         release what yam-estop has latched. Once no other source has latched it, arms move again,
                          each from where it is, with its next target; those whose session has ended since LAND at once
yam-estop release NAME    release what the source with this name has latched; several names, or --all, are possible
yam-estop status          say which sources have latched it, why and when; exit status 1 if any has

yam-estop --host 192.168.1.20          latch that of another computer's arms; with release and status, too

Without --host the command reaches all arms that this user drives on this machine, from any shell; called by root, the
arms of every user. The output names the running sessions that hear the stop. If no session hears it, an arm may go on
moving, and a warning in capitals says so; the exit status stays 0, since no session that starts later energises its
arms. Exit status 1: some arms could not be reached, or a release has left another source's stop latched.
"""

import os
import sys

from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.state.stop_latch import OWN, ROOT, StopLatch
from lerobot_robot_yam.system.runtime_dirs import ENV_RUNTIME_DIR, make_runtime_dir, runtime_dirs, sessions

# Modules that only some calls need are imported there: each costs milliseconds of the time until the arms stop.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import Namespace

_AS_ROOT = 'sudo "$(which yam-estop)"'
_UNHEARD = (
    "NO SESSION RUNS HERE THAT HEARS IT: if an arm moves, switch its power off. It is driven by another "
    f"user ({_AS_ROOT}), in a container, with another {ENV_RUNTIME_DIR}, or by other software. "
    "Latched all the same: no session starts\n"
)
_NOT = {"latch": "NOT STOPPED", "release": "NOT RELEASED", "status": "NOT KNOWN"}
_WHY = "yam-estop"


def main(arguments: list[str] | None = None) -> int:
    """Run `yam-estop`; return its exit status."""
    if not (sys.argv[1:] if arguments is None else arguments):
        return _latch(_WHY, False)
    options = _parse(arguments)
    if options.arms_host is not None:
        return _on_host(options)
    if options.action == "latch":
        return _latch(options.why, options.json)
    return _release_or_show(options)


def _parse(arguments: list[str] | None) -> "Namespace":
    from lerobot_robot_yam.commands.lib.command_line import command_parser
    from lerobot_robot_yam.commands.lib.host_option import add_host_arguments

    parser = command_parser("yam-estop", __doc__)
    parser.add_argument("action", nargs="?", choices=("latch", "release", "status"), default="latch")
    parser.add_argument("sources", nargs="*", metavar="NAME", help="release: sources to release (see status)")
    parser.add_argument("--all", action="store_true", help="release: what all sources have latched")
    parser.add_argument("--why", default=_WHY, help="the reason, for others to read")
    parser.add_argument("--json", action="store_true", help="answer in JSON")
    add_host_arguments(parser)
    options = parser.parse_args(arguments)
    if options.action != "release" and (options.sources or options.all):
        parser.error("NAME and --all belong to release")
    return options


def _latch(why: str, as_json: bool) -> int:
    """Latch the emergency stops of this computer that this user may write; return the exit status."""
    found = runtime_dirs()
    if os.getuid() == 0 and len(found) > 1 and not os.path.exists(found[0]):
        found = found[1:]  # root drives no arm, and other users could not read files in root's directory
    else:
        try:
            make_runtime_dir()  # so that later sessions see the stop
        except ConfigError:  # reported when the stop is written
            pass
    stops, missed = [StopLatch(directory) for directory in found], {}
    for stop in stops:
        try:
            stop.latch(why, _own_source(stop))
        except OSError as error:
            missed[stop.directory] = error
    _report("latch", stops, missed, as_json)
    return int(bool(missed))


def _own_source(stop: StopLatch) -> str:
    """Return the source of this command: another one in another user's directory, which only root can write."""
    try:
        return OWN if os.stat(stop.directory).st_uid == os.getuid() else ROOT
    except OSError:
        return OWN


def _release_or_show(options: "Namespace") -> int:
    """Release latches of this computer, or show them; return the exit status."""
    stops, missed = [StopLatch(directory) for directory in runtime_dirs()], {}
    released: dict[str, dict[str, str]] = {}
    for stop in stops:
        try:
            if options.action == "release":
                before = stop.sources()
                names = list(before) if options.all else options.sources or [_own_source(stop)]
                stop.release(*names or [OWN])
                gone = {name: before[name] for name in names if name in before}
                released |= {stop.directory: gone} if gone else {}
            elif os.path.exists(stop.directory):
                os.listdir(stop.directory)
        except FileNotFoundError:  # no runtime directory, so nothing is latched
            pass
        except OSError as error:
            missed[stop.directory] = error
    _report(options.action, stops, missed, options.json, released)
    latched = any(stop.latched for stop in stops if stop.directory not in missed)
    if options.action == "status":
        return int(latched)
    return int(latched or stops[0].directory in missed)  # of other users' arms only root's release has to reach


def _report(
    action: str,
    stops: list[StopLatch],
    missed: dict[str, OSError],
    as_json: bool,
    released: dict[str, dict[str, str]] | None = None,
) -> None:
    """Print what is latched, what was released and which sessions hear it."""
    reached = [stop for stop in stops if stop.directory not in missed]
    latched = [stop for stop in reached if stop.latched]
    heard = [(stop.directory, key, process) for stop in latched for key, process in sessions(stop.directory).items()]
    if as_json:
        import json

        answer = {
            "latched": bool(latched),
            "reason": latched[0].reason() if latched else "",
            "sources": {stop.directory: stop.sources() for stop in latched},
            "directories": [stop.directory for stop in latched],
            "heard_by": [{"directory": d, "channel": key, "process": process} for d, key, process in heard],
            "missed": {directory: str(error) for directory, error in missed.items()},
        }
        sys.stdout.write(json.dumps(answer) + "\n")
    else:
        for stop in reached:
            where = f" in {stop.directory}" if len(reached) > 1 else ""
            sys.stdout.writelines(f"emergency stop {line}\n" for line in _lines(stop, where, action, released or {}))
        if latched:
            named = [(key, process) for _, key, process in heard]
            sys.stdout.write(f"heard by {_named(named)}\n" if heard else _UNHEARD)
    if missed and not reached and action != "status":
        reasons = "; ".join(map(str, missed.values()))
        sys.stderr.write(f"yam-estop: NOTHING IS STOPPED OR RELEASED: {reasons}; switch the arms' power off\n")
    else:
        for directory, error in missed.items():
            sys.stderr.write(
                f"yam-estop: {_NOT[action]}: arms that are driven by way of {directory}, if any ({error.strerror}); "
                f"their user can, and root: {_AS_ROOT} {action}\n"
            )


def _lines(stop: StopLatch, where: str, action: str, released: dict[str, dict[str, str]]) -> list[str]:
    """Return lines about one stop: what was released, then what is latched; after a release also the driven arms."""
    gone, left = released.get(stop.directory, {}), stop.sources()
    lines = [f"released{where}; it was latched by {name}: {text}" for name, text in gone.items()]
    still = "STILL latched" if action == "release" else "latched"
    remedy = "; its release: yam-estop release " if action == "release" else ""
    lines += [f"{still}{where} by {name}: {text}{remedy and remedy + name}" for name, text in left.items()]
    if gone and not left and (driven := list(sessions(stop.directory).items())):
        lines[-1] += f"\ndriven: {_named(driven)}; arms of running sessions go on, those of ended ones land"
    return lines or [f"not latched{where}"]


def _named(sessions: list[tuple[str, str]]) -> str:
    return ", ".join(f"{key} (process {process})" for key, process in sessions)


def _on_host(options: "Namespace") -> int:
    """Latch, release or show the emergency stop of the host that has the arms; return the exit status."""
    if "site" not in sys.modules:  # started without the site packages, which hold pyzmq
        os.execv(sys.executable, [sys.executable, "-P", "-m", __name__, *sys.argv[1:]])
    import getpass
    import json
    from platform import node

    from lerobot_robot_yam.commands.lib.host_option import ask_host

    fields = {"why": options.why, "who": f"{getpass.getuser()}@{node()}", "sources": options.sources}
    try:
        if options.all:
            fields["sources"] = list(ask_host(options, "estop", action="status")["sources"])
        answer = ask_host(options, "estop", action=options.action, **fields)
    except YamError as error:
        sys.stderr.write(f"yam-estop: {_NOT[options.action]}: {error}; switch the arms' power off\n")
        return 1
    heard, latched = answer["heard_by"], answer["latched"]
    if options.json:
        sys.stdout.write(json.dumps({name: answer[name] for name in ("latched", "reason", "sources", "heard_by")}))
        sys.stdout.write("\n")
    else:
        lines = [f"latched by {name}: {text}" for name, text in answer["sources"].items()] or ["not latched"]
        lines[-1] += f"; arms that hear it: {', '.join(heard) or 'none are driven'}" if latched else ""
        sys.stdout.writelines(f"emergency stop of {options.arms_host} {line}\n" for line in lines)
    return 0 if options.action == "latch" else int(bool(latched))


if __name__ == "__main__":
    sys.exit(main())
