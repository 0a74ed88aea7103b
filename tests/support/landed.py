"""Whether an arm was down when its torque was cut: what it moved since then, not how still it lies by now."""

import math

from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations

MOST_M = 0.01  # landed means that cutting torque then moves no body by more


def moved_after_cut_m(rig: RigOperations, channel: str) -> float:
    """How far the farthest of an arm's bodies has moved since the first of its motors was last switched off.

    Infinite if nobody has switched one off: those that had torque have lost it by themselves.
    """
    cut, let_go = None, False
    for event in rig.events():
        if event.get("channel") != channel:
            continue
        if event["kind"] == "motor_enabled":
            cut, let_go = None, False
        elif event["kind"] == "motor_disabled" and cut is None:
            cut = event["bodies"]
        elif event["kind"] == "motor_fault":
            let_go = True
    if cut is None:
        return math.inf if let_go else 0.0
    now = rig.state(bodies=True)["bodies"]
    return max(math.dist(position, now[body]) for body, position in cut.items())
