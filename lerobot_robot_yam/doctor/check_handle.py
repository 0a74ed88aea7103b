"""The teaching handle of one channel: firmware, report mode, trigger. Its settings are left as they are."""

from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.damiao.handle_encoder import FIRMWARE_REQUIRED, TRIGGER_TRAVEL_RAD, HandleReport
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.doctor.kit.targets import Target

_REPORT_BYTES = 6
_BEYOND = 1.15  # of the trigger's travel: more cannot be a trigger with the right zero
_RELEASED = 0.1  # of the trigger's travel


def handle_firmware(questions: Questions, expected: bool) -> tuple[int, int, int] | None:
    """Firmware version of the handle on the channel, None when none answers. One that is not expected is asked once."""
    question = handle_encoder.encode_version_request(), handle_encoder.REQUEST_ID, handle_encoder.decode_version
    return questions.handle(*question) if expected else questions.handle(*question, attempts=1)


def inspect_handle(
    questions: Questions, target: Target, firmware: tuple[int, int, int] | None, section: Section
) -> None:
    """Ask the handle, and check what it says."""
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
    if report is not None:
        _check_trigger(target, where, report, section)


def _check_trigger(target: Target, where: str, report: HandleReport, section: Section) -> None:
    angle, zero = abs(report.position_rad), f"yam-handle zero {target.config.on_command_line}"
    if angle > TRIGGER_TRAVEL_RAD * _BEYOND:
        what = f"the trigger reads {report.position_rad:.3f} rad, beyond its travel of {TRIGGER_TRAVEL_RAD} rad"
        section.problem(where, what, f"release the trigger, then set its zero: {zero}")
    elif report.trigger > _RELEASED:
        what = f"the trigger reads {report.trigger:.2f}: it is squeezed, or its zero is wrong"
        section.warn(where, what, f"release it; if it still reads so, set its zero: {zero}")


def _report(data: bytes) -> HandleReport | None:
    return handle_encoder.decode_report(data) if len(data) == _REPORT_BYTES else None


def _eeprom(questions: Questions, offset: int) -> int | None:
    request = handle_encoder.encode_eeprom_read(offset)
    return questions.handle(request, handle_encoder.REQUEST_ID, handle_encoder.decode_eeprom_byte)


def _dotted(version: tuple[int, int, int]) -> str:
    return ".".join(map(str, version))
