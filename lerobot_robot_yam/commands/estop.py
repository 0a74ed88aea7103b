"""yam-estop            latch the emergency stop: followers hold, leaders float, nothing is energised
yam-estop release    let arms move again, each from where it is, with its next target
yam-estop status     say whether it is latched, by whom and why; exit status 1 if it is
"""

import argparse
import json
import sys
from collections.abc import Sequence

from lerobot_robot_yam.arm.estop import EmergencyStop


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the command."""
    parser = argparse.ArgumentParser(
        prog="yam-estop", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("action", nargs="?", choices=("latch", "release", "status"), default="latch")
    parser.add_argument("--why", default="yam-estop", help="what others are told")
    parser.add_argument("--json", action="store_true", help="answer in JSON")
    options = parser.parse_args(arguments)
    stop = EmergencyStop()
    try:
        if options.action == "latch":
            stop.latch(options.why)
        elif options.action == "release":
            stop.release()
    except OSError as error:
        sys.stderr.write(f"yam-estop: NOTHING IS STOPPED OR RELEASED: {error}; use the hardware's emergency stop\n")
        return 1
    reason = stop.reason()
    if options.json:
        sys.stdout.write(json.dumps({"latched": stop.latched, "reason": reason}) + "\n")
    else:
        sys.stdout.write(f"emergency stop latched: {reason}\n" if reason else "emergency stop not latched\n")
    return int(options.action == "status" and stop.latched)


if __name__ == "__main__":
    sys.exit(main())
