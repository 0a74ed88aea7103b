"""Serve a LeRobot checkpoint on openpi's websocket protocol, for arms that are driven from another computer.

yam-policy-server --policy.path=outputs/train/my_policy/checkpoints/last/pretrained_model
yam-policy-server --policy.path=my_policy --policy.device=cuda --policy.n_action_steps=25
yam-policy-server --policy.path=my_policy --host=0.0.0.0 --api-key-env=POLICY_KEY    for other computers

Further --policy.… options are those that lerobot-rollout takes for the checkpoint. Any openpi client can connect; this
package's client is --policy.type=yam_openpi of lerobot-rollout. Ctrl-C ends the server.
"""

import argparse
import logging
import os
import sys
from collections.abc import Sequence

import yaml

from lerobot_robot_yam.commands.lib.command_line import command_parser, run_command
from lerobot_robot_yam.errors import ConfigError

logger = logging.getLogger(__name__)

_OVERRIDE = "--policy."
_OURS = ("--policy.path", "--policy.discover_packages_path")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-policy-server`; return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    parser = command_parser("yam-policy-server", __doc__, allow_abbrev=False)
    path, packages = _OURS
    parser.add_argument(path, dest="path", required=True, help="directory of the checkpoint, or its name on the hub")
    parser.add_argument(packages, dest="packages", metavar="PACKAGE", help="a package with policies or processors")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this computer)")
    parser.add_argument("--port", type=int, default=8000, help="port to listen on (default 8000)")
    parser.add_argument("--api-key-env", metavar="NAME", help="variable with the key that clients have to send")
    parser.add_argument("--task", default="", help="prompt for clients that send none")
    parser.add_argument(
        "--rename_map", type=_names, default={}, help="names that clients use, and what the policy calls them, as JSON"
    )
    parser.add_argument("--any-image-size", action="store_true", help="for policies that resize images themselves")
    named = {argument.partition("=")[0] for argument in arguments if argument.startswith(_OVERRIDE)}
    overrides = sorted(named - set(_OURS))
    for option in overrides:
        parser.add_argument(option, dest=option, help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    fields = [f"--{option.removeprefix(_OVERRIDE)}={getattr(args, option)}" for option in overrides]
    return run_command("yam-policy-server", lambda: _serve(args, fields))


def _serve(args: argparse.Namespace, fields: Sequence[str]) -> int:
    from lerobot.configs.parser import PluginLoadError, load_plugin  # imported late: loads torch

    from lerobot_robot_yam.face.openpi.chunk_server import ChunkServer
    from lerobot_robot_yam.face.openpi.served_policy import ServedPolicy
    from lerobot_robot_yam.viewer.serving.access import is_loopback

    key = os.environ.get(args.api_key_env) if args.api_key_env else None
    if args.api_key_env and not key:
        raise ConfigError(f"--api-key-env names {args.api_key_env}, which is not set in the environment")
    if key is None and not is_loopback(args.host):
        raise ConfigError(
            f"with --host={args.host} the whole network could use it; put a key into the environment and name its "
            "variable with --api-key-env, or stay on 127.0.0.1 and use an ssh tunnel"
        )
    logging.getLogger("lerobot_robot_yam").setLevel(logging.INFO)
    if args.packages:
        try:
            load_plugin(args.packages)
        except PluginLoadError as error:
            raise ConfigError(str(error)) from error
    policy = ServedPolicy(args.path, fields, args.rename_map, args.task, args.any_image_size)
    server = ChunkServer(policy, args.host, args.port, key)
    try:
        logger.info("it says of itself: %s", policy.metadata)
        logger.info("listening on ws://%s:%d; Ctrl-C ends it", args.host, server.port)
        server.serve_forever()
    except KeyboardInterrupt:
        logger.info("interrupted")
    finally:
        server.close()
    return 0


def _names(text: str) -> dict[str, str]:
    """Parse a mapping of names on the command line. Raises argparse.ArgumentTypeError: the text is no such mapping."""
    found = yaml.safe_load(text)
    if not isinstance(found, dict) or not all(isinstance(name, str) for pair in found.items() for name in pair):
        raise argparse.ArgumentTypeError(f"give a dictionary of names, such as {{observation.image: …}}, not {text}")
    return found


if __name__ == "__main__":
    sys.exit(main())
