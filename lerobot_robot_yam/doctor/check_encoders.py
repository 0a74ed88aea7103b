"""Check of the encoders on one channel: a teaching handle, or a leader without motors. Changes no settings."""

import shlex
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.leaders.passive_config import PassiveConfig
from lerobot_robot_yam.control.teleop.passive_mapping import PassiveCalibration, PassiveMapping
from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.damiao.handle_encoder import FIRMWARE_REQUIRED, TRIGGER_TRAVEL_RAD, HandleReport
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.doctor.kit.targets import Target
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_REPORT_BYTES = 6
_BEYOND = 1.15  # share of the travel that a trigger with a correct zero cannot exceed
_RELEASED = 0.1  # maximum share of the travel at which a trigger counts as released
_BEYOND_RAD = 0.2  # tolerance of a passive leader's joints beyond the follower's range, rad: the leader moves further
_CABLE = "check power and cable of the passive leader, and that this is its channel"


def handle_firmware(questions: Questions) -> tuple[int, int, int] | None:
    """Read the firmware version of the handle on the channel; return None if no handle replies."""
    request = handle_encoder.encode_version_request()
    return questions.handle(request, handle_encoder.REQUEST_ID, handle_encoder.decode_version)


def inspect_handle(
    questions: Questions, target: Target, firmware: tuple[int, int, int] | None, section: Section
) -> None:
    """Read the handle's state and settings, and check firmware, report mode and trigger."""
    where = f"{target.channel} teaching handle"
    report = questions.handle(handle_encoder.encode_report_request(), handle_encoder.REPORT_ID, _report)
    if firmware is None and report is None:
        section.rows.append({"channel": target.channel, "firmware": "no answer"})
        what = "does not answer: the arm works without it, but has no trigger and no buttons"
        section.problem(where, what, "check the handle's cable, or name a gripper profile without a handle")
        return
    low = _eeprom(questions, handle_encoder.EEPROM_REPORT_FREQUENCY_LOW)
    high = _eeprom(questions, handle_encoder.EEPROM_REPORT_FREQUENCY_HIGH)
    frequency = None if low is None or high is None else handle_encoder.decode_frequency(low, high)
    row = {
        "channel": target.channel,
        "firmware": firmware and _dotted(firmware),
        "report_frequency_hz": frequency,
        "trigger": report and round(report.trigger, 3),
        "trigger_rad": report and round(report.position_rad, 4),
        "buttons": report and [int(button) for button in report.buttons],
    }
    section.rows.append(row)
    if firmware is not None and firmware < FIRMWARE_REQUIRED:
        what = f"has firmware {_dotted(firmware)}; {_dotted(FIRMWARE_REQUIRED)} or later is needed"
        section.problem(where, what, "update its firmware with the arm vendor's tool")
    if frequency:
        what = f"reports by itself at {frequency} Hz, which takes the bus from the motors; it should wait to be asked"
        section.problem(where, what, f"yam-handle report {target.config.on_command_line} 0")
    for name, value in (("firmware", firmware), ("report frequency", frequency), ("trigger", report)):
        if value is None:
            section.warn(where, f"its {name} is unknown: it does not tell", "run yam-doctor again")
    zero = f"yam-handle zero {target.config.on_command_line}"
    if report is not None and abs(report.position_rad) > TRIGGER_TRAVEL_RAD * _BEYOND:
        what = f"the trigger reads {report.position_rad:.3f} rad, beyond its travel of {TRIGGER_TRAVEL_RAD} rad"
        section.problem(where, what, f"release the trigger, then set its zero: {zero}")
    elif report is not None and report.trigger > _RELEASED:
        what = f"the trigger reads {report.trigger:.2f}: it is squeezed, or its zero is wrong"
        section.warn(where, what, f"release it; if it still reads so, set its zero: {zero}")


def inspect_passive(questions: Questions, target: Target, config: PassiveConfig, section: Section) -> None:
    """Read and check the encoders of a leader without motors; request reports from encoders that send none."""
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
        row["trigger"] = round(mapping.trigger(encoders.angle_rad[-1]), 3)
        row["buttons"] = [int(button) for button in encoders.buttons]
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


def _report(data: bytes) -> HandleReport | None:
    return handle_encoder.decode_report(data) if len(data) == _REPORT_BYTES else None


def _eeprom(questions: Questions, offset: int) -> int | None:
    request = handle_encoder.encode_eeprom_read(offset)
    return questions.handle(request, handle_encoder.REQUEST_ID, handle_encoder.decode_eeprom_byte)


def _dotted(version: tuple[int, int, int]) -> str:
    return ".".join(map(str, version))
