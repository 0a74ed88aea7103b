"""Renderer process of a virtual rig, started by the rig.

    python -m lerobot_robot_yam.rig.render.renderer --rig NAME --requests-fd FD

The renderer reads the world's state block, renders each open camera at the camera's rate, and publishes the latest
frame of each camera. Requests arrive as JSON packets over a socket:
{"do": "open" or "close", "camera": [name, width, height, fps]}, {"do": "stall", "camera": name, "until_s": monotonic
time}. Replies are {"ready": camera} or {"error": text}. With --on-demand the renderer renders only on request:
{"do": "draw", "anew": whether the world was restarted}; the reply is {"drawn": true}.

The renderer exits when the other end of the socket is closed, so it never outlives the rig. It yields to other
processes and skips late frames, because hardware cameras do not slow a recording down either.
"""

import argparse
import json
import logging
import os
import select
import socket
import sys
import time
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.client.launch import MAX_PACKET, to_json, told_scene
from lerobot_robot_yam.system.realtime import give_way

if TYPE_CHECKING:
    from lerobot_robot_yam.rig.render.drawing import Drawing


def _serve(drawing: "Drawing", requests: socket.socket, on_demand: bool) -> None:
    while True:
        due_s = None if on_demand else drawing.next_due_s()
        timeout = None if due_s is None else max(0.0, due_s - time.monotonic())
        if select.select([requests], [], [], timeout)[0]:
            packet = requests.recv(MAX_PACKET)
            if not packet:
                return
            _obey(drawing, json.loads(packet), requests)
        elif not on_demand:
            drawing.draw_due(time.monotonic())


def _obey(drawing: "Drawing", request: dict[str, Any], answers: socket.socket) -> None:
    verb = request["do"]
    camera: Any = request.get("camera")
    if verb == "stall":
        drawing.stall(camera, request["until_s"])
    elif verb == "draw":
        if request["anew"]:
            drawing.begin_anew()
        drawing.draw_all()
        answers.send(to_json({"drawn": True}))
    elif verb == "close":
        drawing.close(tuple(camera))
    else:
        drawing.open(tuple(camera))
        answers.send(to_json({"ready": camera}))


def _draw_for(rig: str) -> "Drawing":
    # mujoco reads this variable on import, and the import fails if the OpenGL libraries are missing.
    os.environ["MUJOCO_GL"] = "egl"
    # Software OpenGL renders in this thread. By default it would use all cores; with one separate thread each frame
    # would take 20 % longer and wait twice for a processor on a busy machine.
    os.environ["LP_NUM_THREADS"] = "0"
    from lerobot_robot_yam.rig.render.drawing import Drawing

    return Drawing(rig, told_scene(rig))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", required=True, help="name of the running rig")
    parser.add_argument("--requests-fd", type=int, required=True, help="socket for requests and answers")
    parser.add_argument("--on-demand", action="store_true", help="draw when told to, for a rig in lock-step")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="renderer: %(levelname)s: %(message)s")
    requests = socket.socket(fileno=args.requests_fd)
    if not args.on_demand:
        give_way()
    try:
        drawing = _draw_for(args.rig)
    except YamError as error:
        requests.send(to_json({"error": str(error)}))
        return 1
    except (ImportError, AttributeError) as error:  # raised by PyOpenGL if a library is missing
        missing = f"rendered cameras need OpenGL through EGL, whose libraries are not installed ({error})"
        requests.send(to_json({"error": f"{missing}; sudo apt install libegl1 libgl1-mesa-dri"}))
        raise
    try:
        _serve(drawing, requests, args.on_demand)
    except (KeyboardInterrupt, BrokenPipeError, ConnectionResetError):
        pass  # the rig is ending
    finally:
        drawing.close_all()
    return 0


if __name__ == "__main__":
    sys.exit(main())
