"""The virtual rig's process: sockets outside, physics inside, one thread.

    python -m lerobot_robot_yam.rig.server.server --name NAME [--scene SCENE] [--set key=value ...]

`launch` starts it. It wakes for packets and for physics, steps the world up to now and answers each packet at once
as one packet. It ends about a second after its last client has left.
"""

import argparse
import gc
import json
import logging
import os
import signal
from typing import Any

import mujoco

from lerobot_robot_yam.errors import RigError, YamError
from lerobot_robot_yam.rig.client.launch import add_scene_arguments, error_reply, options_of, rig_path, scene_arguments
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.server.serving import RigServer
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.realtime import request_realtime

logger = logging.getLogger(__name__)

PRIORITY = 10  # below the control loops, above everything ordinary


def main() -> None:
    """Entry point of the server process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--name", required=True, help="the rig's name")
    add_scene_arguments(parser)
    parser.add_argument("--owner", type=int, help="end with this process")
    parser.add_argument("--ready-fd", type=int, help="write one JSON line here once up")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")
    mujoco.set_mju_user_warning(lambda text: logger.warning("MuJoCo: %s", text))  # else it writes a file
    gc.disable()  # until everything is built; request_realtime freezes it
    try:
        options = options_of(args)
        device = RigDevice(load_scene(args.scene, options))
        if device.scene.options.event_dir is not None:
            folder = user_path(device.scene.options.event_dir)
            device.events.keep(folder / rig_path(args.name, "events.jsonl").name)
        server = RigServer(args.name, device, scene_arguments(args.scene, options), args.owner)
    except Exception as error:
        known = error if isinstance(error, YamError) else RigError(f"rig {args.name} crashed at its start: {error!r}")
        _report(args.ready_fd, error_reply(known))
        raise
    signal.signal(signal.SIGTERM, lambda *_: server.stop())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.enable()
    server.realtime = request_realtime(PRIORITY)
    logger.info("rig %s, pid %d, scene %s: %s", args.name, os.getpid(), device.scene.name, server.realtime)
    _report(args.ready_fd, {"pid": os.getpid()})
    try:
        server.run()
    except BaseException:
        logger.exception("rig %s crashed", args.name)
        os.rename(rig_path(args.name, "log"), rig_path(args.name, "crash"))
        raise
    finally:
        server.close()


def _report(fd: int | None, message: dict[str, Any]) -> None:
    if fd is not None:
        os.write(fd, json.dumps(message).encode() + b"\n")
        os.close(fd)


if __name__ == "__main__":
    main()
