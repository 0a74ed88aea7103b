"""The motors of one channel: who is there, what they hold in their registers, and what contradicts the profile."""

from collections.abc import Mapping, Sequence
from typing import Any

from lerobot_robot_yam.damiao.codec import decode_feedback
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS, MotorSpec
from lerobot_robot_yam.damiao.registers import Register, agrees
from lerobot_robot_yam.damiao.tables import (
    MOTOR_TYPES,
    TIMEOUT_COUNT_S,
    WATCHDOG_S,
    ControlMode,
    Fault,
    fault_text,
    motor_type,
)
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.questions import Answer, Questions
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, Target

_ROUNDS = 3
_TIMEOUT_S, _SETTLE_S = 0.25, 0.03
# The maker says so; others have seen that a motor takes it at once.
_POWER_CYCLE = " (then switch the arm's power off and on: until then the motor may go by the old value)"
_WARM_C = 15.0  # this far below the motor's own limit
_SUPPLY_MARGIN = 1.05
_SILENT_MAX = 3  # a motor that has not told so many registers in a row is not asked for more
_READ = {
    Register.SW_VER: "firmware",
    Register.SUB_VER: "firmware_sub",
    Register.HW_VER: "hardware",
    Register.SN: "serial",
    Register.GR: "gear_ratio",
    Register.PMAX: "position_max_rad",
    Register.VMAX: "velocity_max_rad_s",
    Register.TMAX: "torque_max_nm",
    Register.TIMEOUT: "timeout_counts",
    Register.CTRL_MODE: "control_mode",
    Register.MST_ID: "answers_on",
    Register.OT_VALUE: "temperature_limit_c",
    Register.UV_VALUE: "supply_min_v",
    Register.OV_VALUE: "supply_max_v",
    Register.VBUS: "supply_v",
}
_CONNECT = "connect again: that clears the fault"
_FAULT_REMEDIES: dict[int, str] = {
    Fault.OVER_VOLTAGE: f"measure the supply, then {_CONNECT}",
    Fault.UNDER_VOLTAGE: f"check the supply and its cable, then {_CONNECT}",
    Fault.OVER_CURRENT: f"turn the joint by hand and look for what blocks it, then {_CONNECT}",
    Fault.MOS_OVER_TEMPERATURE: f"let the motor cool down, then {_CONNECT}",
    Fault.ROTOR_OVER_TEMPERATURE: f"let the motor cool down, then {_CONNECT}",
    Fault.COMMUNICATION_LOST: f"{_CONNECT} (its last driver ended without switching torque off)",
    Fault.OVERLOAD: f"take off the load or what blocks the joint, then {_CONNECT}",
    Fault.NORMAL: "hold the arm by hand, then switch its power off and on",
}


def inspect_motors(questions: Questions, target: Target, handle_answers: bool, section: Section) -> list[MotorSpec]:
    """Ask all motors of a channel and check what they say; returns those of the profile that are there."""
    specs = target.hardware.motors
    answers = _roll_call(questions, [spec.can_id for spec in specs])
    present = [spec for spec in specs if spec.can_id in answers]
    missing = [spec for spec in specs if spec.can_id not in answers]
    strangers = sorted(set(answers) - {spec.can_id for spec in specs})
    _check_missing(target, specs, missing, handle_answers, section)
    for can_id in strangers:
        _stranger(target, can_id, missing, section)
    for spec in present:
        given, rounds = answers[spec.can_id]
        row = _read(questions, target, spec, given[-1])
        section.rows.append(row)
        where = _where(target, spec)
        if len(given) > rounds:
            _doubled(target, spec, missing, section)
        _check_state(where, row, section)
        _check_registers(target, spec, given[-1], row, section)
    for spec in missing:
        section.rows.append({**_identity(target, spec), "state": "missing"})
    _check_firmware(target, present, section)
    return present


def _where(target: Target, spec: MotorSpec) -> str:
    return f"{target.channel} motor {spec.name} (id {spec.can_id})"


def _identity(target: Target, spec: MotorSpec) -> dict[str, Any]:
    return {"channel": target.channel, "id": spec.can_id, "name": spec.name, "type": spec.type}


def _roll_call(questions: Questions, expected: Sequence[int]) -> dict[int, tuple[list[Answer], int]]:
    """Per id that answers: its answers, and how often it was asked."""
    answers: dict[int, list[Answer]] = {}
    asked = dict.fromkeys(MOTOR_IDS, 0)
    for _ in range(_ROUNDS):
        # Unexpected ids are given less time, and only once.
        absent = [can_id for can_id in MOTOR_IDS if can_id not in expected and not asked[can_id]]
        for ids, timeout_s in ((list(expected), _TIMEOUT_S), (absent, _SETTLE_S)):
            for can_id in ids:
                asked[can_id] += 1
            for answer in questions.refresh(ids, timeout_s, _SETTLE_S) if ids else ():
                answers.setdefault(answer.nibble, []).append(answer)
    return {can_id: (given, asked[can_id]) for can_id, given in answers.items()}


def _check_missing(
    target: Target, specs: Sequence[MotorSpec], missing: Sequence[MotorSpec], handle: bool, section: Section
) -> None:
    if len(missing) == len(specs):
        what = f"none of the {len(specs)} motors answers" + (", though the teaching handle does" if handle else "")
        remedy = "switch the arm's power on and release its emergency stop; if it is on, check the CAN cable"
        section.problem(target.channel, what, remedy)
        return
    names = {spec.can_id: spec.name for spec in specs}
    motor = target.hardware.gripper.motor
    replaced = [spec for spec in missing if handle and motor is not None and spec.can_id == motor.can_id]
    for spec in replaced:
        what = "a teaching handle answers instead of the gripper's motor: this is a leader"
        remedy = f"name it --channel {target.channel}:{target.config.arm}:{LEADER_GRIPPER}, or swap the cables back"
        section.problem(_where(target, spec), what, remedy)
    specs, missing = ([spec for spec in some if spec not in replaced] for some in (specs, missing))
    to_the_end = not handle and list(missing) == list(specs[-len(missing) :])  # the handle is behind them
    behind = [spec.name for spec in missing[1:]] if to_the_end else []
    for spec in missing[:1] if behind else missing:
        before = names.get(spec.can_id - 1)
        cable = f"the cable between {before} and {spec.name}" if before else f"the cable to {spec.name}"
        what = f"no answer to {_ROUNDS} questions" + (f", nor from {', '.join(behind)} behind it" if behind else "")
        section.problem(_where(target, spec), what, f"reseat {cable}, then switch the arm's power off and on")


def _stranger(target: Target, can_id: int, missing: Sequence[MotorSpec], section: Section) -> None:
    remedy = f"name the profile that has it (--channel {target.channel}:ARM:GRIPPER), or take the motor off the bus"
    if len(missing) == 1:
        remedy = f"if it is {missing[0].name}: {_become(target, can_id, missing[0])}"
    what = "a motor answers that the profile does not have"
    section.problem(f"{target.channel} motor id {can_id}", what, remedy)


def _doubled(target: Target, spec: MotorSpec, missing: Sequence[MotorSpec], section: Section) -> None:
    remedy = f"unplug {spec.name}, then give the other one its own id"
    if len(missing) == 1:
        remedy += f" ({missing[0].name}): {_become(target, spec.can_id, missing[0])}"
    else:
        remedy += f" (yam-motors set-id {target.config.on_command_line} {spec.can_id} NEW)"
    what = "answers twice: two motors share this id, or another program asks as well"
    section.problem(_where(target, spec), what, remedy)


def _become(target: Target, can_id: int, spec: MotorSpec) -> str:
    """The command that gives the motor with this id the ids of the profile's `spec`."""
    return _set_registers(target, can_id, {Register.ESC_ID: spec.can_id, Register.MST_ID: spec.feedback_id})


def _read(questions: Questions, target: Target, spec: MotorSpec, answer: Answer) -> dict[str, Any]:
    feedback = decode_feedback(spec.type, answer.data)
    row: dict[str, Any] = {
        **_identity(target, spec),
        "state": fault_text(answer.fault),
        "fault": answer.fault,
        "position_rad": round(feedback.position, 4),
        "temp_mos_c": feedback.temp_mos,
        "temp_rotor_c": feedback.temp_rotor,
    }
    silent = 0
    for register, key in _READ.items():
        row[key] = questions.register(spec.can_id, register) if silent < _SILENT_MAX else None
        silent = silent + 1 if row[key] is None else 0
    counts = row["timeout_counts"]
    row["timeout_s"] = None if counts is None else round(counts * TIMEOUT_COUNT_S, 5)
    return row


def _check_state(where: str, row: Mapping[str, Any], section: Section) -> None:
    fault, mos, rotor = row["fault"], row["temp_mos_c"], row["temp_rotor_c"]
    if fault == Fault.NORMAL:
        what = "is energised although no session drives it"
        section.problem(where, what, _FAULT_REMEDIES[fault])
    elif fault != Fault.DISABLED:
        remedy = _FAULT_REMEDIES.get(fault, "switch the arm's power off and on")
        section.problem(where, f"reports {fault_text(fault)}; power stage {mos} °C, coil {rotor} °C", remedy)
    limit = row["temperature_limit_c"]
    if limit and max(mos, rotor) > limit - _WARM_C:
        what = f"power stage {mos} °C, coil {rotor} °C; it switches itself off at {limit:g} °C"
        section.warn(where, what, "let it rest before the next session, and reduce what it holds")
    supply, least, most = row["supply_v"], row["supply_min_v"], row["supply_max_v"]
    low = supply and least and supply < least * _SUPPLY_MARGIN
    if low or (supply and most and supply * _SUPPLY_MARGIN > most):
        what = f"the supply is {supply:.1f} V; it switches itself off at {least if low else most:g} V"
        section.warn(where, what, "check the supply and its cable" if low else "check the supply")


def _check_registers(target: Target, spec: MotorSpec, answer: Answer, row: Mapping[str, Any], section: Section) -> None:
    where, kind = _where(target, spec), motor_type(spec.type)
    ratio = row["gear_ratio"]
    other_type = ratio and kind.gear_ratio is not None and not agrees(ratio, kind.gear_ratio)
    if other_type:
        fitting = [name for name, other in MOTOR_TYPES.items() if other.gear_ratio and agrees(ratio, other.gear_ratio)]
        what = f"its gear ratio is {ratio:g} ({' or '.join(fitting) or 'no known type'}) instead of {kind.gear_ratio:g}"
        what += f" ({spec.type}): another arm or gripper than the profile says"
        section.problem(where, what, f"name the right one: --channel {target.channel}:ARM:GRIPPER")
    expected: dict[Register, float] = {Register.TIMEOUT: round(WATCHDOG_S / TIMEOUT_COUNT_S)}
    expected |= {Register.CTRL_MODE: ControlMode.MIT, Register.MST_ID: spec.feedback_id}
    if not other_type:  # otherwise its ranges are those of the other type
        ranges = kind.position_max_rad, kind.velocity_max_rad_s, kind.torque_max_nm
        expected |= dict(zip((Register.PMAX, Register.VMAX, Register.TMAX), ranges, strict=True))
    unknown = []
    for register, value in expected.items():
        found = answer.identifier if register is Register.MST_ID else row[_READ[register]]
        name, unit = register.name, register.unit
        if found is None:
            unknown.append(name)
        elif not agrees(found, value):
            what = f"{name} is {found:g} instead of {value:g} {unit}{_consequence(register, found)}"
            again = _POWER_CYCLE if register is Register.TIMEOUT else ""
            section.problem(where, what, _set_registers(target, spec.can_id, {register: value}) + again)
    if unknown:
        what = f"{', '.join(unknown)} unknown: the motor does not tell"
        section.warn(where, what, "run yam-doctor again; if it stays so, check the motor's cable")


def _set_registers(target: Target, motor_id: int, values: Mapping[Register, float]) -> str:
    """The command that sets registers of a motor and stores them. The doctor prints it and changes nothing."""
    where = target.config.on_command_line
    if not values.keys().isdisjoint({Register.ESC_ID, Register.MST_ID}):
        return f"yam-motors set-id {where} {motor_id} {int(values.get(Register.ESC_ID, motor_id))}"
    if Register.TIMEOUT in values:
        return f"yam-motors timeout {where} --motor {motor_id} {values[Register.TIMEOUT] * TIMEOUT_COUNT_S:g}"
    settings = " ".join(f"{register.name}={value:.9g}" for register, value in values.items())
    return f"yam-motors write {where} --motor {motor_id} {settings} --store"


def _consequence(register: Register, found: float) -> str:
    if register is Register.TIMEOUT:
        if found == 0:
            return ": it never switches itself off when its driver dies"
        return f": it switches itself off after {found * TIMEOUT_COUNT_S:g} s without a command"
    if register in (Register.PMAX, Register.VMAX, Register.TMAX):
        return ": every value on the wire is scaled wrongly"
    return ""


def _check_firmware(target: Target, present: Sequence[MotorSpec], section: Section) -> None:
    """Motors of one type with different firmware are worth knowing about."""
    rows = [row for row in section.rows if row["channel"] == target.channel and row.get("firmware") is not None]
    for kind in sorted({spec.type for spec in present}):
        versions = sorted({row["firmware"] for row in rows if row["type"] == kind})
        if len(versions) > 1:
            what = f"its {kind} motors have different firmware: {', '.join(map(str, versions))}"
            section.note(target.channel, what, "none needed while all of them behave alike")
