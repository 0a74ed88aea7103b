"""A leader without motors: are all its encoders heard, do its zeros fit, is its trigger released?"""

import shlex
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.leaders.passive_config import PassiveConfig
from lerobot_robot_yam.control.passive.passive_mapping import PassiveCalibration, PassiveMapping
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.doctor.kit.targets import Target
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_RELEASED = 0.1  # of the trigger's travel
_BEYOND_RAD = 0.2  # of its follower's range: the leader's own stops are a little wider
_CABLE = "check power and cable of the passive leader, and that this is its channel"


def inspect_passive(questions: Questions, target: Target, config: PassiveConfig, section: Section) -> None:
    """Listen to its encoders, ask those that do not report by themselves, and check what they say."""
    channel, joints = target.channel, target.hardware.joints
    encoders, quiet = questions.encoders(joints)
    silent = encoders.silent(0.0)
    row: dict[str, Any] = {"channel": channel, "silent": silent, "quiet": quiet, "buttons": None}
    section.rows.append(row)
    if answers := questions.refresh(range(1, joints + 1), timeout_s=0.05, settle_s=0.0):
        ids = ", ".join(str(answer.nibble) for answer in answers)
        section.problem(channel, f"motors answer (id {ids}): that is no passive leader", "name it as a yam_leader")
    mapping = _mapping(target, config, section)
    if len(silent) > joints:
        section.problem(channel, "none of its encoders answers", _CABLE)
        return
    for name in silent:
        section.problem(f"{channel} {name}", "its encoder is silent", _CABLE)
    if waiting := [name for name in quiet if name not in silent]:
        what = f"{', '.join(waiting)}: reports only when asked, until a session begins"
        section.note(channel, what, "nothing to do: the first session tells it to")
    if mapping is None:
        return
    q, _ = mapping.joints(encoders.angle_rad[:joints], np.zeros(joints))
    heard = np.isfinite(encoders.stamp_s)
    row["q_rad"] = [round(float(value), 3) if known else None for value, known in zip(q, heard[:-1], strict=True)]
    low, high = target.hardware.arm.joint_limits_rad.T
    for joint in np.flatnonzero(heard[:-1] & ((q < low - _BEYOND_RAD) | (q > high + _BEYOND_RAD))):
        what = f"reads {q[joint]:.2f} rad, beyond its follower's {low[joint]:.2f} … {high[joint]:.2f} rad"
        section.warn(f"{channel} joint_{joint + 1}", what, f"find its zeros again: {target.calibrate}")
    if heard[-1]:
        row["trigger"], row["buttons"] = (
            round(mapping.trigger(encoders.angle_rad[-1]), 3),
            [*map(int, encoders.buttons)],
        )
        if row["trigger"] > _RELEASED:
            what = f"the trigger reads {row['trigger']:.2f}: it is squeezed, or its zero is wrong"
            section.warn(channel, what, f"release it; if it still reads so: {target.calibrate}")


def _mapping(target: Target, config: PassiveConfig, section: Section) -> PassiveMapping | None:
    assert config.calibration_path is not None
    path = user_path(config.calibration_path)
    try:
        mapping = PassiveMapping(target.config.name, config, target.hardware.arm.joint_limits_rad)
        stored = PassiveCalibration.load(target.config.name, path, target.hardware.joints)
    except ConfigError as error:
        again = f"rm {shlex.quote(str(path))} && {target.calibrate}" if path.exists() else target.calibrate
        section.problem(target.channel, str(error), again)
        return None
    if stored is None:
        what = f"no zeros are stored in {path}: those in the encoders count"
        section.warn(target.channel, what, f"lay it at home, trigger released, then: {target.calibrate}")
    return mapping
