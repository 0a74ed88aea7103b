"""Whether an arm was down when its torque was cut: what it moved since then, not how still it lies by now."""

import math

from lerobot_robot_yam.rig.control import RigOperations

MOST_M = 0.01  # issue and README: cutting torque then moves no body by more


def moved_after_cut_m(rig: RigOperations, channel: str) -> float:
    """How far the farthest of an arm's bodies has moved since the first of its motors was last switched off."""
    cut = None
    for event in rig.events():
        if event.get("channel") == channel and event["kind"] == "motor_enabled":
            cut = None
        elif event.get("channel") == channel and event["kind"] == "motor_disabled" and cut is None:
            cut = event["bodies"]
    if cut is None:
        return 0.0
    now = rig.state(bodies=True)["bodies"]
    return max(math.dist(position, now[body]) for body, position in cut.items())
