"""List the cameras, preview their pictures, tune their exposure, and name them by their roles in a run config.

yam-cameras list                                          what is plugged in: serial numbers, links, formats
yam-cameras preview sheet.png                             a picture of each camera on one sheet
yam-cameras tune 841113021535                             finds the exposure of one camera, by measured brightness
yam-cameras tune top --config=rig.yaml                    the camera of a role; writes the exposure down, too
yam-cameras name --config=rig.yaml                        asks for the role of each camera, and writes it
yam-cameras name --config=rig.yaml top=841113021535       writes this one

The rest of the config stays as it is. Exit status: 0 done; 1 it cannot be done; 2 wrong arguments; 130 interrupted.
"""

import argparse
import difflib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lerobot_robot_yam.cameras.opening import Plugged, config_of, find_camera, listed, plugged_cameras
from lerobot_robot_yam.cameras.role_names import ROLES, named_cameras, read_config, with_cameras
from lerobot_robot_yam.cameras.video_devices import ROOT
from lerobot_robot_yam.commands.lib.camera_bench import TARGET, Bench
from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.commands.lib.dialogue import agreed, ask, need_terminal, say, table, tell
from lerobot_robot_yam.errors import CameraError, ConfigError, SetupError
from lerobot_robot_yam.system.paths import user_path, write_whole

_NONE = "there is no camera; plug one in (`lsusb` lists what is plugged in)"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-cameras`; return its exit status."""
    parser = command_parser("yam-cameras", __doc__)
    actions = parser.add_subparsers(dest="work", required=True)
    shows = actions.add_parser("list", help="show what is plugged in")
    shows.add_argument("--formats", action="store_true", help="all formats of each camera")
    preview = actions.add_parser("preview", help="write a picture of each camera on one sheet")
    preview.add_argument("sheet", type=user_path, metavar="FILE.png")
    tune = actions.add_parser("tune", help="find the exposure of one camera")
    tune.add_argument("camera", nargs="?", help="serial number, model, or role in the config; the only camera without")
    tune.add_argument("--target", type=float, default=TARGET, help="mean brightness, 0 to 1 (default %(default)s)")
    tune.add_argument("--sheet", type=user_path, metavar="FILE.png", help="write pictures of before and after")
    name = actions.add_parser("name", help="write cameras by their roles into a config")
    name.add_argument("pairs", nargs="*", metavar="ROLE=SERIAL", help=f"without any, it asks ({', '.join(ROLES)}, …)")
    for work in (preview, tune, name):
        default = Path("cameras.yaml") if work is name else None
        work.add_argument(
            "--config", type=user_path, default=default, help="run config with roles (name: cameras.yaml)"
        )
        work.add_argument("--width", type=int, default=640, help="pixels (default 640)")
        work.add_argument("--height", type=int, default=480, help="pixels (default 480)")
        work.add_argument("--fps", type=int, default=30, help="pictures per second (default 30)")
    for work in (tune, name):
        work.add_argument("--dry-run", action="store_true", help="show what would change in the config, change nothing")
        work.add_argument("--yes", action="store_true", help="do not ask before the config is changed")
    for work in (shows, preview, tune, name):
        work.add_argument("--root", type=user_path, default=ROOT, help="another computer's files: sys, dev")
    args = parser.parse_args(arguments)
    works = {"list": _list, "preview": _preview, "tune": _tune, "name": _name}
    return run_command("yam-cameras", lambda: works[args.work](args))


def _plugged(args: argparse.Namespace) -> list[Plugged]:
    """Return the connected cameras. Raises CameraError: no camera is connected."""
    cameras = plugged_cameras(args.root)
    if not cameras:
        raise CameraError(_NONE)
    return cameras


def _list(args: argparse.Namespace) -> int:
    cameras = plugged_cameras(args.root)
    rows = []
    for camera in cameras:
        seen = camera.seen
        link = f"USB {2 if seen.slow else 3}" if seen and seen.speed_mbit else "-"
        nodes = ", ".join(node.name for node in seen.nodes) if seen else "-"
        port = seen.usb.port if seen and seen.usb else "-"
        rows.append([camera.serial or "-", camera.model, port, link, nodes or "-"])
    say(table(["serial", "model", "USB port", "link", "nodes"], rows))
    if not cameras:
        tell(_NONE)
    for camera in cameras:
        if args.formats:
            say(f"{camera}: {', '.join(camera.modes()) or 'tells no formats'}")
        if camera.seen and camera.seen.realsense and camera.seen.slow:
            tell(f"{camera}: USB 2 is too slow for a RealSense; use a USB 3 port (blue) with a USB 3 cable")
    return 0


def _preview(args: argparse.Namespace) -> int:
    roles, cameras = _roles(args.config), _plugged(args)
    bench, failed = Bench(args.width, args.height, args.fps), False
    for camera in cameras:
        title = f"{roles.get(camera.serial or '', '')} {camera.model} {camera.serial or ''}".strip()
        try:
            tell(f"{title}: {bench.look(camera, title)}")
        except (CameraError, ConfigError) as error:
            tell(f"{title}: {error}")
            bench.miss(title)
            failed = True
    bench.write(args.sheet)
    tell(f"written: {args.sheet}")
    return 1 if failed else 0


def _tune(args: argparse.Namespace) -> int:
    if not 0.0 < args.target < 1.0:
        raise ConfigError(f"--target {args.target:g} is out of range; brightness is between 0 and 1")
    camera = _chosen(args)
    bench = Bench(args.width, args.height, args.fps)
    before, exposure, after = bench.tune(camera, args.target, tell)
    tell(f"before: {before}\nafter: {after}")
    say(f"exposure: {exposure}")
    if args.sheet:
        bench.write(args.sheet)
    if args.config:
        roles = {serial: role for serial, role in _roles(args.config).items() if camera.is_called(serial)}
        if not roles:
            raise ConfigError(f"{args.config} names no camera {camera.serial}: `yam-cameras name` writes it there")
        fields = {"type": "yam_realsense", "exposure": exposure}
        _write(args, dict.fromkeys(roles.values(), fields))
    return 0


def _chosen(args: argparse.Namespace) -> Plugged:
    """Return the camera to tune.

    Raises:
        CameraError: the named camera is missing, or no camera was named and not exactly one is connected.
    """
    if args.camera is not None:
        roles = named_cameras(read_config(args.config)) if args.config else {}
        return find_camera(str(roles.get(args.camera, {}).get("serial_number_or_name", args.camera)), args.root)
    cameras = plugged_cameras(args.root)
    if len(cameras) != 1:
        raise CameraError(f"say which camera, by its serial number; there are: {listed(cameras)}")
    return cameras[0]


def _name(args: argparse.Namespace) -> int:
    pairs = dict(pair.partition("=")[::2] for pair in args.pairs)
    for role, serial in pairs.items():
        if not role.isidentifier() or not serial:
            raise ConfigError(f"{role}={serial}: give a role of letters, digits and _, then = and a serial number")
    found = {role: find_camera(serial, args.root) for role, serial in pairs.items()} or _asked(args)
    if found:
        size = {"width": args.width, "height": args.height, "fps": args.fps}
        _write(args, {role: config_of(camera, args.root) | size for role, camera in found.items()})
    return 0


def _asked(args: argparse.Namespace) -> dict[str, Plugged]:
    """Ask the user for the role of each camera; return role -> camera, without the cameras that were skipped."""
    cameras = _plugged(args)
    need_terminal(False)
    found: dict[str, Plugged] = {}
    tell(f"Which camera is it ({', '.join(ROLES)}, or a name of yours)? `yam-cameras preview` shows what each sees.")
    for camera in cameras:
        while (role := ask(f"{camera} (Enter skips it):")) and (not role.isidentifier() or role in found):
            tell("that is taken" if role in found else "take letters, digits and _")
        if role:
            found[role] = camera
    return found


def _roles(config: Path | None) -> dict[str, str]:
    """Return serial number -> role of the cameras in a run config; empty without a config."""
    cameras = named_cameras(read_config(config)) if config else {}
    return {str(fields.get("serial_number_or_name")): role for role, fields in cameras.items()}


def _write(args: argparse.Namespace, cameras: Mapping[str, Mapping[str, Any]]) -> None:
    """Show the changes to the config, ask for confirmation (not with --yes), and write (not with --dry-run)."""
    before = read_config(args.config)
    after = with_cameras(before, cameras)
    if after == before:
        tell(f"{args.config}: nothing to change")
        return
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    tell("\n".join([f"{args.config}:", *(line for line in list(lines)[2:] if not line.startswith("@@"))]))
    if args.dry_run:
        return
    need_terminal(args.yes)
    if not args.yes and not agreed("Make this change?"):
        tell("nothing was changed")
        return
    try:
        write_whole(args.config, after)
    except OSError as error:
        raise SetupError(f"{args.config} cannot be written: {error}") from error


if __name__ == "__main__":
    sys.exit(main())
