"""Whether commands asked motors for more torque than their clips, by what the rig says the shafts truly did."""

import numpy as np

from lerobot_robot_yam.arm.hardware import Hardware

KNOWN_S = 0.012  # a command acts for a tick, on a state that is a tick old when it is sent, and each took its way
SLACK_NM, SLACK = 0.5, 1.05  # what a frame cannot tell: kp and kd times half a bit; and a share of the clip
_STEP_S = 0.001


def beyond_clip_nm(truth: dict[str, np.ndarray], hardware: Hardware, known_s: np.ndarray | float) -> np.ndarray:
    """The largest torque of each joint in Nm that commands asked for beyond the clip; 0 where all kept to it.

    A command that keeps to the clip by a state of up to `known_s` ago asks for more where the joint has moved since:
    by  kp (q before − q now) + kd (dq before − dq now), which no driver can know. Whatever state before explains a
    torque is taken to be the one that the driver knew.

    Args:
        truth: of `RigOperations.truth`, steps of 1 ms.
        hardware: with the gains and clips of the commands.
        known_s: (n,) or one for all joints.
    """
    n = hardware.joints
    kp, kd = hardware.kp[:n], hardware.kd[:n]
    clip = SLACK * hardware.torque_limit_nm[:n] + SLACK_NM
    q, dq, asked = (truth[key][:, :n] for key in ("q", "dq", "asked_nm"))
    lags = np.broadcast_to(np.round(np.asarray(known_s) / _STEP_S).astype(int), n)
    beyond = np.abs(asked) - clip
    for lag in range(1, int(lags.max(initial=0)) + 1):
        moved = kp * (q[:-lag] - q[lag:]) + kd * (dq[:-lag] - dq[lag:])
        explained = np.where(lag <= lags, np.abs(asked[lag:] - moved) - clip, np.inf)
        beyond[lag:] = np.minimum(beyond[lag:], explained)
    return np.maximum(beyond.max(axis=0, initial=0.0), 0.0)
