"""Whether commands asked motors for more torque than their clips, by what the rig says the shafts truly did."""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from scripts import recorders

KNOWN_S = 0.012  # a command acts for a tick, on a state that is a tick old when it is sent, and each took its way
_SLACK_NM, _SLACK = 0.5, 1.05  # what a frame cannot tell: kp and kd times half a bit; and a share of the clip
_KEPT_S = 30.0
_BLOW_RAD_S, _BLOW_S = 10.0, 0.004  # a joint that gains more speed from one answer to the next is not believed any more


def look_at(rig: RigOperations, channel: str) -> None:
    """Record the arm's extremes, and what its motors do, from now on."""
    recorders.watch_start(rig, channel)
    recorders.truth_start(rig, channel, _KEPT_S)


def beyond_nm(
    rig: RigOperations, channel: str, hardware: ResolvedArm, known_s: np.ndarray | float = KNOWN_S
) -> np.ndarray:
    """The largest torque of each joint in Nm that was asked for beyond the clip since `look_at`; see `beyond_clip_nm`.

    A joint that a falling part of its arm has struck counts until the blow: what it says then no joint can do, so it is
    held where it was sent, and nobody can know how fast it is.

    Args:
        hardware: with the gains and clips of the commands.
        known_s: (n,) or one for all joints: how old the state may be that a command rests on, with the command's age.
    """
    n = hardware.joints
    clip_nm = _SLACK * hardware.torque_limit_nm[:n] + _SLACK_NM
    if (np.array(recorders.watch(rig, channel)["max_asked_nm"][:n]) <= clip_nm).all():
        return np.zeros(n)
    truth = recorders.truth(rig, channel)
    steps, count = round(_BLOW_S / recorders.STEP_S), len(truth["stamp_s"])
    dq, asked = truth["dq"].reshape(count, -1), truth["asked_nm"].reshape(count, -1).copy()
    for joint in range(n):
        blows = np.flatnonzero(np.abs(dq[steps:, joint] - dq[:-steps, joint]) > _BLOW_RAD_S)
        if len(blows):
            asked[blows[0] :, joint] = 0.0
    return recorders.beyond_clip_nm({**truth, "asked_nm": asked}, hardware.kp[:n], hardware.kd[:n], clip_nm, known_s)
