"""Whether commands asked motors for more torque than their clips, by what the rig says the shafts truly did."""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.rig.client.rig_operations import RigOperations
from lerobot_robot_yam.rig.judging.recorders import beyond_clip_nm

KNOWN_S = 0.012  # a command acts for a tick, on a state that is a tick old when it is sent, and each took its way
_SLACK_NM, _SLACK = 0.5, 1.05  # what a frame cannot tell: kp and kd times half a bit; and a share of the clip
_KEPT_S = 30.0


def look_at(rig: RigOperations, channel: str) -> None:
    """Record the arm's extremes, and what its motors do, from now on."""
    rig.watch_start(channel)
    rig.truth_start(channel, _KEPT_S)


def beyond_nm(
    rig: RigOperations, channel: str, hardware: ResolvedArm, known_s: np.ndarray | float = KNOWN_S
) -> np.ndarray:
    """The largest torque of each joint in Nm that was asked for beyond the clip since `look_at`; see `beyond_clip_nm`.

    Args:
        hardware: with the gains and clips of the commands.
        known_s: (n,) or one for all joints: how old the state may be that a command rests on, with the command's age.
    """
    n = hardware.joints
    clip_nm = _SLACK * hardware.torque_limit_nm[:n] + _SLACK_NM
    if (np.array(rig.watch(channel)["max_asked_nm"][:n]) <= clip_nm).all():
        return np.zeros(n)
    return beyond_clip_nm(rig.truth(channel), hardware.kp[:n], hardware.kd[:n], clip_nm, known_s)
