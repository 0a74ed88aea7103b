"""Let another computer drive the arms of this computer, with LeRobot's own commands (docs/two-machines.md).

yam-host --config_path=rig.yaml           serve the arms of a rig's file, to programs of this computer
yam-host --config_path=rig.yaml --listen 192.168.1.20      to paired computers, too
yam-host pair workstation                 make keys for a computer; carry the file to it
yam-host status                           say what the host that runs here serves, and who has it

HAZARD: a paired computer can ENERGISE the arms. Starting yam-host does not. The arms land however yam-host ends.
"""

import argparse
import contextlib
import json
import logging
import resource
import shlex
import signal
import subprocess
import sys
from collections.abc import Hashable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command, seconds
from lerobot_robot_yam.commands.lib.dialogue import say, tell
from lerobot_robot_yam.errors import ConfigError, LifeCycleError

if TYPE_CHECKING:
    from lerobot_robot_yam.remote.host_address import HostAddress
    from lerobot_robot_yam.remote.hosted_group import HostedGroup

_LAND_AFTER_S = 30.0
_LOCAL = "127.0.0.1"
_RT_PRIORITY = 15  # real-time priority, below the control loops', so that a flood of messages cannot delay these loops
_SWITCH_S = 0.0005  # Python's thread switch interval, s: short, so that sending states hardly delays receiving commands
_TOOL_TIMEOUT_S = 120.0
_MOST_BYTES = 200_000  # maximum size of a tool's output sent to the client, bytes; the rest is cut off

logger = logging.getLogger(__name__)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-host`; return its exit status."""
    parser = command_parser("yam-host", __doc__)
    parser.add_argument("action", nargs="?", choices=("serve", "pair", "status"), default="serve")
    parser.add_argument("name", nargs="?", help="pair: what the other computer is called here")
    parser.add_argument("--config_path", type=Path, help="the rig's file, as yam-setup writes it")
    parser.add_argument("--listen", help="address, or address:port (default 127.0.0.1: this computer alone)")
    parser.add_argument("--keys", type=Path, help="directory of this host's keys (default ~/.config/yam/host-keys)")
    parser.add_argument("--out", type=Path, help="pair: the file to make (default NAME.yam-key.json)")
    parser.add_argument(
        "--land_after_s",
        type=seconds,
        default=_LAND_AFTER_S,
        help="a client that is silent for so long has its arms landed, s (default 30)",
    )
    args = parser.parse_args(arguments)
    action = {"serve": _serve, "pair": _pair, "status": _status}[args.action]
    return run_command("yam-host", lambda: action(args))


def _serve(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.remote.host_address import HostAddress
    from lerobot_robot_yam.remote.host_server import HostServer
    from lerobot_robot_yam.remote.link_keys import keys_directory, paired
    from lerobot_robot_yam.remote.link_sockets import HostSockets
    from lerobot_robot_yam.system.log_thread import log_from_a_thread
    from lerobot_robot_yam.system.paths import user_path
    from lerobot_robot_yam.system.realtime import raise_threads, request_scheduling

    if args.config_path is None:
        raise ConfigError("which arms? Give --config_path=rig.yaml, the file that yam-setup writes")
    logging.getLogger().setLevel(logging.INFO)
    groups = groups_of(args.config_path)
    address = HostAddress.of(args.listen or _LOCAL)
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # every connection to the open port takes a descriptor
    keys = args.keys or keys_directory()
    keys = keys if paired(keys) else None
    channels = {channel: words for group in groups for channel, words in group.channels.items()}
    tools = HostTools(user_path(args.config_path).absolute(), channels)
    server = HostServer(HostSockets(address, keys), groups, args.land_after_s, tools.run)
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: ended.append(number))
    _say_ready(address, groups, keys is not None)
    sys.setswitchinterval(_SWITCH_S)
    request_scheduling(_RT_PRIORITY)
    raise_threads(_RT_PRIORITY, "ZMQbg/IO")
    with _noted(address, keys), log_from_a_thread():
        server.run(lambda: bool(ended))
        tools.close()
    return 0


def _note() -> Path:
    """Return the path of the file with the running host's address and key, for `yam-host status`."""
    from lerobot_robot_yam.system.runtime_files import runtime_dir

    return runtime_dir() / "host-address"


@contextlib.contextmanager
def _noted(address: "HostAddress", keys: Path | None) -> Iterator[None]:
    from lerobot_robot_yam.remote.link_keys import HOST_KEY

    with contextlib.suppress(OSError):  # without the file, `yam-host status` needs the address as an option
        key = None if keys is None else str((keys / HOST_KEY).absolute())
        _note().write_text(json.dumps({"address": str(address), "key": key}))
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            _note().unlink()


def _say_ready(address: "HostAddress", groups: "Sequence[HostedGroup]", keyed: bool) -> None:
    served = "; ".join(f"{group.role}: {', '.join(part.key for part in group.parts)}" for group in groups)
    who = "paired computers" if keyed else "programs of this computer, WITHOUT KEYS"
    tell(f"yam-host serves {served}\nlistening on {address} for {who}; nothing is energised yet. Ctrl-C lands and ends")


def groups_of(path: Path) -> "list[HostedGroup]":
    """Read a rig's file, and create the groups. Raises ConfigError: see `read_rig`."""
    from lerobot_robot_yam.commands.servers.rig_reader import read_rig
    from lerobot_robot_yam.remote.hosted_group import HostedGroup

    groups: list[HostedGroup] = []
    for device in read_rig(path):
        first = sum(len(group.parts) for group in groups)
        groups.append(HostedGroup(device.role, device.type, device.configs, device.options, first))
    return groups


def _pair(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.remote.link_keys import keys_directory, pair

    if args.name is None:
        raise ConfigError("which computer? Give it a name: yam-host pair workstation")
    target = args.out or Path(f"{args.name}.yam-key.json")
    pair(args.keys or keys_directory(), args.name, target)
    tell(
        f"made {target}: carry it to {args.name} (scp), remove it here, and name it there as key, such as "
        f"--robot.key={target}. Whoever has it can drive the arms. A host that runs has to be started anew"
    )
    return 0


def _status(args: argparse.Namespace) -> int:
    from lerobot_robot_yam.remote.host_address import HostAddress
    from lerobot_robot_yam.remote.host_question import Host, hello
    from lerobot_robot_yam.remote.link_keys import HOST_KEY, keys_directory, paired

    directory = args.keys or keys_directory()
    names = paired(directory)
    say(f"paired: {', '.join(names) or 'none'}")
    at: dict[str, str | None] = {"address": args.listen or _LOCAL, "key": str(directory / HOST_KEY) if names else None}
    if args.listen is None:
        with contextlib.suppress(OSError, ValueError):
            at = json.loads(_note().read_text())
    told = hello(Host(HostAddress.of(str(at["address"])), at["key"]))
    say(f"{told['computer']} serves, lerobot_robot_yam {told['package']}")
    for role, group in told["groups"].items():
        keys = ", ".join(part["key"] for part in group["parts"].values())
        say(f"{role} ({keys}): {group['phase']}{' for ' * bool(group['holder'])}{group['holder']}")
    say(f"emergency stop: {told['stop'] or 'not latched'}")
    return 0


class HostTools:
    """Runner of this computer's read-only commands yam-doctor and yam-identify for clients, one at a time.

    Args:
        rig_file: file that describes this host's arms.
        channels: CAN channel that may be identified -> command-line options that select this channel.
    """

    def __init__(self, rig_file: Path, channels: Mapping[str, str]):
        self._rig_file, self._channels = rig_file, channels
        self._thread = ThreadPoolExecutor(1, "yam-tool")
        self._running: Future[subprocess.CompletedProcess[bytes]] | None = None
        self._asked: Hashable = None

    def run(self, asked: Hashable, tool: str, channel: str, as_json: bool) -> dict[str, Any] | None:
        """Start a tool; return its exit status and output once it has ended, or None while it runs.

        Args:
            asked: key of the client's request; the client repeats the request until the tool has ended.
            tool: "doctor" or "identify".
            channel: channel to identify.
            as_json: whether the output is JSON.

        Raises:
            ConfigError: the host has no such tool or channel.
            LifeCycleError: another tool is running, or this tool exceeded its timeout.
        """
        if self._running is None or asked != self._asked:
            if self._running is not None and not self._running.done():
                raise LifeCycleError("the host still looks at its arms for somebody; try again in a moment")
            command = self._command(tool, channel, as_json)
            logger.info("runs %s for a client", " ".join(command[2:]))
            self._asked = asked
            self._running = self._thread.submit(
                subprocess.run, command, stdin=subprocess.DEVNULL, capture_output=True, timeout=_TOOL_TIMEOUT_S
            )
        if not self._running.done():
            return None
        try:
            done = self._running.result()
        except subprocess.TimeoutExpired as error:
            raise LifeCycleError(
                f"{tool} does not end on the host; it was ended after {_TOOL_TIMEOUT_S:g} s"
            ) from error
        out, complaints = (said[:_MOST_BYTES].decode(errors="replace") for said in (done.stdout, done.stderr))
        return {"status": done.returncode, "out": out, "err": complaints}

    def _command(self, tool: str, channel: str, as_json: bool) -> list[str]:
        if tool == "doctor":
            arguments = ["lerobot_robot_yam.commands.doctor", f"--config_path={self._rig_file}"]
        elif tool == "identify" and channel in self._channels:
            arguments = ["lerobot_robot_yam.commands.identify", *shlex.split(self._channels[channel])]
        else:
            raise ConfigError(f"the host has no {tool} {channel}; its channels are {', '.join(self._channels)}")
        return [sys.executable, "-m", *arguments, *(["--json"] if as_json else [])]

    def close(self) -> None:
        """Wait until the running tool has ended. Idempotent."""
        self._thread.shutdown()


if __name__ == "__main__":
    sys.exit(main())
