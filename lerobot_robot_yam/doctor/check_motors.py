"""Check of the motors on one channel: presence, registers, and deviations from the profile."""

from collections.abc import Mapping, Sequence
from typing import Any

from lerobot_robot_yam.damiao.codec import decode_feedback
from lerobot_robot_yam.damiao.motor_inspection import expected_registers
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS, MotorSpec
from lerobot_robot_yam.damiao.registers import Register, agrees
from lerobot_robot_yam.damiao.tables import MOTOR_TYPES, TIMEOUT_COUNT_S, Fault, fault_text
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.questions import Answer, Questions
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, BaseTarget, Examined, Target
from lerobot_robot_yam.mobile.base_config import BASE
from lerobot_robot_yam.mobile.rail_profile import RAIL_MOTOR

_ROUNDS = 3
_TIMEOUT_S, _SETTLE_S = 0.25, 0.03
# Hint after a change of the timeout. The maker requires a power cycle; others have seen a value apply at once.
_POWER_CYCLE = " (then switch the power off and on: until then the motor may go by the old value)"
_WARM_C = 15.0  # distance to a motor's temperature limit within which the motor counts as warm, °C
_SUPPLY_MARGIN = 1.05  # ratio of supply voltage and limit below which the supply counts as near the limit
_SILENT_MAX = 3  # consecutive unanswered reads after which a motor's remaining registers are skipped
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
_RANGES = (Register.PMAX, Register.VMAX, Register.TMAX)
_CONNECT = "connect again: that clears the fault"
_FAULT_REMEDIES: dict[int, str] = {
    Fault.OVER_VOLTAGE: f"measure the supply, then {_CONNECT}",
    Fault.UNDER_VOLTAGE: f"check the supply and its cable, then {_CONNECT}",
    Fault.OVER_CURRENT: f"turn the joint by hand and look for what blocks it, then {_CONNECT}",
    Fault.MOS_OVER_TEMPERATURE: f"let the motor cool down, then {_CONNECT}",
    Fault.ROTOR_OVER_TEMPERATURE: f"let the motor cool down, then {_CONNECT}",
    Fault.COMMUNICATION_LOST: f"{_CONNECT} (its last driver ended without switching torque off)",
    Fault.OVERLOAD: f"take off the load or what blocks the joint, then {_CONNECT}",
}


def inspect_motors(questions: Questions, target: Examined, handle_answers: bool, section: Section) -> list[MotorSpec]:
    """Query all motors of a channel and check their replies; return the profile's motors that reply."""
    specs = target.hardware.motors
    answers = _roll_call(questions, [spec.can_id for spec in specs])
    present = [spec for spec in specs if spec.can_id in answers]
    missing = [spec for spec in specs if spec.can_id not in answers]
    _check_missing(target, specs, missing, handle_answers, section)
    for can_id in sorted(set(answers) - {spec.can_id for spec in specs}):
        if isinstance(target, BaseTarget) and can_id == RAIL_MOTOR.can_id:
            remedy = "give the base `rail` in its config, and name it by --config_path FILE"
            section.note(f"{target.channel} motor id {can_id}", "a rail's motor answers; it was not looked at", remedy)
            continue
        remedy = f"name the profile that has it (--channel {target.channel}:ARM:GRIPPER), or take the motor off the bus"
        if len(missing) == 1:
            remedy = f"if it is {missing[0].name}: {_set_id(target, can_id, missing[0].can_id)}"
        what = "a motor answers that the profile does not have"
        section.problem(f"{target.channel} motor id {can_id}", what, remedy)
    for spec in present:
        given, rounds = answers[spec.can_id]
        row = _read(questions, target, spec, given[-1])
        section.rows.append(row)
        if len(given) > rounds:
            other = f" ({missing[0].name})" if len(missing) == 1 else ""
            remedy = f"unplug {spec.name}, then give the other one its own id{other}: "
            remedy += _set_id(target, spec.can_id, missing[0].can_id if other else "NEW")
            what = "answers twice: two motors share this id, or another program asks as well"
            section.problem(_where(target, spec), what, remedy)
        _check_state(_where(target, spec), row, section)
        _check_registers(target, spec, given[-1], row, section)
    section.rows += [{**_identity(target, spec), "state": "missing"} for spec in missing]
    _check_firmware(target, present, section)
    return present


def _where(target: Examined, spec: MotorSpec) -> str:
    return f"{target.channel} motor {spec.name} (id {spec.can_id})"


def _identity(target: Examined, spec: MotorSpec) -> dict[str, Any]:
    return {"channel": target.channel, "id": spec.can_id, "name": spec.name, "type": spec.type}


def _roll_call(questions: Questions, expected: Sequence[int]) -> dict[int, tuple[list[Answer], int]]:
    """Query all ids; return id -> (replies, number of queries) for each id that replies."""
    answers: dict[int, list[Answer]] = {}
    unexpected = [can_id for can_id in MOTOR_IDS if can_id not in expected]  # queried once, with a shorter timeout
    calls = [(list(expected), _TIMEOUT_S)] * _ROUNDS + [(unexpected, _SETTLE_S)]
    for ids, timeout_s in calls:
        for answer in questions.refresh(ids, timeout_s, _SETTLE_S):
            answers.setdefault(answer.nibble, []).append(answer)
    return {can_id: (given, _ROUNDS if can_id in expected else 1) for can_id, given in answers.items()}


def _check_missing(
    target: Examined,
    specs: Sequence[MotorSpec],
    missing: Sequence[MotorSpec],
    handle: bool,
    section: Section,
) -> None:
    if len(missing) == len(specs):
        what = f"none of the {len(specs)} motors answers" + (", though the teaching handle does" if handle else "")
        remedy = f"switch the {target.noun}'s power on and release its emergency stop; if it is on, check the CAN cable"
        section.problem(target.channel, what, remedy)
        return
    names = {spec.can_id: spec.name for spec in specs}
    motor = target.hardware.gripper.motor if isinstance(target, Target) else None
    if isinstance(target, Target) and handle and missing and motor is not None and missing[-1].can_id == motor.can_id:
        what = "a teaching handle answers instead of the gripper's motor: this is a leader"
        remedy = f"name it --channel {target.channel}:{target.config.arm}:{LEADER_GRIPPER}, or swap the cables back"
        section.problem(_where(target, missing[-1]), what, remedy)
        missing = missing[:-1]
    # The motors are daisy-chained: all motors behind a broken cable are silent. A handle comes after the last motor.
    behind = missing[1:] if not handle and list(missing) == list(specs[-len(missing) :]) else ()
    for spec in missing[:1] if behind else missing:
        before = names.get(spec.can_id - 1)
        cable = f"the cable between {before} and {spec.name}" if before else f"the cable to {spec.name}"
        nor = f", nor from {', '.join(other.name for other in behind)} behind it" if behind else ""
        remedy = f"reseat {cable}, then switch the {target.noun}'s power off and on"
        section.problem(_where(target, spec), f"no answer to {_ROUNDS} questions{nor}", remedy)


def _read(questions: Questions, target: Examined, spec: MotorSpec, answer: Answer) -> dict[str, Any]:
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
        section.problem(where, what, "hold it by hand, then switch its power off and on")
    elif fault != Fault.DISABLED:
        remedy = _FAULT_REMEDIES.get(fault, "switch the power off and on")
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


def _check_registers(
    target: Examined, spec: MotorSpec, answer: Answer, row: Mapping[str, Any], section: Section
) -> None:
    where, expected = _where(target, spec), expected_registers(spec)
    ratio, wanted = row["gear_ratio"], expected.pop(Register.GR, None)
    if ratio and wanted is not None and not agrees(ratio, wanted):
        fitting = [name for name, other in MOTOR_TYPES.items() if other.gear_ratio and agrees(ratio, other.gear_ratio)]
        what = f"its gear ratio is {ratio:g} ({' or '.join(fitting) or 'no known type'}) instead of {wanted:g}"
        what += f" ({spec.type}): another {'motor' if target.noun == BASE else 'arm or gripper'} than the profile says"
        named = f"name the right one: --channel {target.channel}:ARM:GRIPPER"
        section.problem(where, what, "exchange it for the maker's motor" if target.noun == BASE else named)
        expected = {register: value for register, value in expected.items() if register not in _RANGES}
    unknown = []
    for register, value in expected.items():
        found = answer.identifier if register is Register.MST_ID else row[_READ[register]]
        if found is None:
            unknown.append(register.name)
        elif not agrees(found, value):
            what = f"{register.name} is {found:g} instead of {value:g} {register.unit}{_consequence(register, found)}"
            section.problem(where, what, _set_register(target, spec.can_id, register, value))
    if unknown:
        what = f"{', '.join(unknown)} unknown: the motor does not tell"
        section.warn(where, what, "run yam-doctor again; if it stays so, check the motor's cable")


def _set_register(target: Examined, motor_id: int, register: Register, value: float) -> str:
    """Return the command that sets and stores a motor's register. The doctor only prints this command."""
    where = target.config.on_command_line
    if register is Register.MST_ID:
        return _set_id(target, motor_id, motor_id)
    if register is Register.TIMEOUT:
        return f"yam-motors timeout {where} --motor {motor_id} {value * TIMEOUT_COUNT_S:g}{_POWER_CYCLE}"
    return f"yam-motors write {where} --motor {motor_id} {register.name}={value:.9g} --store"


def _set_id(target: Examined, motor_id: int, new: int | str) -> str:
    """Return the command that gives a motor an id and the matching reply identifier."""
    return f"yam-motors set-id {target.config.on_command_line} {motor_id} {new}"


def _consequence(register: Register, found: float) -> str:
    if register is Register.TIMEOUT:
        if found == 0:
            return ": it never switches itself off when its driver dies"
        return f": it switches itself off after {found * TIMEOUT_COUNT_S:g} s without a command"
    return ": every value on the wire is scaled wrongly" if register in _RANGES else ""


def _check_firmware(target: Examined, present: Sequence[MotorSpec], section: Section) -> None:
    """Add a note if motors of one type have different firmware."""
    rows = [row for row in section.rows if row["channel"] == target.channel and row.get("firmware") is not None]
    for kind in sorted({spec.type for spec in present}):
        versions = sorted({row["firmware"] for row in rows if row["type"] == kind})
        if len(versions) > 1:
            what = f"its {kind} motors have different firmware: {', '.join(map(str, versions))}"
            section.note(target.channel, what, "none needed while all of them behave alike")
