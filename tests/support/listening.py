"""A program with LeRobot's own key listener, and our pseudo-terminal under it. Says which of its flags are set.

python -m tests.support.listening HOW: it ends by itself when it stops ("return", "raise"), or by what is sent to it.
"""

import sys
import time

from lerobot.utils.keyboard_input import init_keyboard_listener

from lerobot_robot_yam.face.operator_keys.pseudo_terminal import pseudo_terminal


def say(*words):
    sys.stdout.write(" ".join(map(str, words)) + "\n")
    sys.stdout.flush()


def main(how):
    terminal = pseudo_terminal()
    terminal.take()
    listener, events = init_keyboard_listener()
    say("listens", listener is not None)
    told = set()
    try:
        while not events["stop_recording"]:
            for name in [name for name, is_set in events.items() if is_set and name not in told]:
                told.add(name)
                say("flag", name)
            time.sleep(0.01)
        if how == "raise":
            raise RuntimeError("as a broken command does")
    finally:
        if how == "return":
            terminal.give_back()
            listener.stop()


if __name__ == "__main__":
    main(sys.argv[1])
