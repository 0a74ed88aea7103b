"""Renderer of a virtual rig, which starts it.

    python -m lerobot_robot_yam.rig.render.renderer --rig NAME

Reads the world's state block, draws each camera that it was asked for at that camera's rate, and publishes the
newest frame of each. Requests come as JSON lines on standard input: {"do": "open" or "close", "camera": [name, width,
height, fps]}, {"do": "stall", "camera": name, "until_s": monotonic time}. Answers go to standard output: {"ready":
camera} or {"error": text}. With --on-demand it draws only when told to: {"do": "draw", "anew": whether the world was
restarted}, answered by {"drawn": true}.

It ends when its input does, so it never outlives the rig. It gives way to other processes, and skips pictures that are
late: cameras of hardware cost a recording no time either.
"""

import argparse
import logging
import os
import select
import sys
import time
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.client.json_messages import LineReader, to_line
from lerobot_robot_yam.rig.client.launch import told_scene
from lerobot_robot_yam.system.realtime import give_way

if TYPE_CHECKING:
    from lerobot_robot_yam.rig.render.drawing import Drawing


def _serve(drawing: "Drawing", answers: int, on_demand: bool) -> None:
    requests = LineReader()
    while True:
        due_s = None if on_demand else drawing.next_due_s()
        timeout = None if due_s is None else max(0.0, due_s - time.monotonic())
        if select.select([0], [], [], timeout)[0]:
            chunk = os.read(0, 65536)
            if not chunk:
                return
            for request in requests.read(chunk):
                _obey(drawing, request, answers)
        if not on_demand:
            drawing.draw_due(time.monotonic())


def _obey(drawing: "Drawing", request: dict[str, Any], answers: int) -> None:
    verb = request["do"]
    camera: Any = request.get("camera")
    if verb == "stall":
        drawing.stall(camera, request["until_s"])
    elif verb == "draw":
        if request["anew"]:
            drawing.begin_anew()
        drawing.draw_all()
        _answer(answers, {"drawn": True})
    elif verb == "close":
        drawing.close(tuple(camera))
    else:
        drawing.open(tuple(camera))
        _answer(answers, {"ready": camera})


def _answer(answers: int, message: dict[str, Any]) -> None:
    os.write(answers, to_line(message))


def _draw_for(rig: str) -> "Drawing":
    # mujoco reads it at its import, and fails there if OpenGL's libraries are missing.
    os.environ["MUJOCO_GL"] = "egl"
    # Software OpenGL draws in this thread, so as not to use both cores. A separate thread cost a fifth more, and two
    # waits for a processor per picture on a busy machine.
    os.environ["LP_NUM_THREADS"] = "0"
    from lerobot_robot_yam.rig.render.drawing import Drawing

    return Drawing(rig, told_scene(rig))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", required=True, help="name of the running rig")
    parser.add_argument("--on-demand", action="store_true", help="draw when told to, for a rig in lock-step")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="renderer: %(levelname)s: %(message)s")
    answers = os.dup(1)
    os.dup2(2, 1)  # prints of libraries must not mix with the answers
    if not args.on_demand:
        give_way()
    try:
        drawing = _draw_for(args.rig)
    except YamError as error:
        _answer(answers, {"error": str(error)})
        return 1
    except (ImportError, AttributeError) as error:  # PyOpenGL's error for a missing library
        missing = f"rendered cameras need OpenGL through EGL, whose libraries are not installed ({error})"
        _answer(answers, {"error": f"{missing}; sudo apt install libegl1 libgl1-mesa-dri"})
        raise
    try:
        _serve(drawing, answers, args.on_demand)
    except (KeyboardInterrupt, BrokenPipeError):
        pass  # the rig is ending
    finally:
        drawing.close_all()
    return 0


if __name__ == "__main__":
    sys.exit(main())
