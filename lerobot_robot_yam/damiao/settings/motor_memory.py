"""All registers of one motor: read, compare, change in RAM, and store in flash without side effects on others."""

from collections.abc import Mapping
from typing import NamedTuple

from lerobot_robot_yam.damiao.codec import unpack_feedback
from lerobot_robot_yam.damiao.registers import Register, encode_value
from lerobot_robot_yam.damiao.settings.register_access import RegisterAccess
from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.errors import BusError, MotorError

Contents = dict[Register, float | int]
"""Register -> value of a motor; registers that the motor does not report are missing."""

MEASURED = frozenset({Register.VBUS, Register.TPCB, Register.TMTR, Register.P_M, Register.XOUT})
"""Registers that contain a measurement, so they change by themselves."""
_UNUSED_GAINS = (500.0, 5.0)  # gain ranges, not needed to decode feedback


class MotorState(NamedTuple):
    """State of a motor, from its feedback: rad, rad/s, Nm, °C."""

    fault: int
    position_rad: float
    velocity_rad_s: float
    torque_nm: float
    temp_mos_c: int
    temp_rotor_c: int


def read_contents(access: RegisterAccess, motor_id: int) -> Contents:
    """Read all registers that the motor reports; empty if the motor does not reply.

    Raises:
        MotorError: two motors share this id, so their replies cannot be distinguished.
    """
    found = access.replies(motor_id, Register.ESC_ID)
    _require_one(access, motor_id, len(found))
    if not found:
        return {}
    told = {register: access.read(motor_id, register) for register in Register}
    return {register: value for register, value in told.items() if value is not None}


def read_state(access: RegisterAccess, motor_id: int) -> MotorState | None:
    """Read a motor's feedback, decoded with the ranges in its registers; None if the motor sends none."""
    told = [access.read(motor_id, r) for r in (Register.MST_ID, Register.PMAX, Register.VMAX, Register.TMAX)]
    if None in told:
        return None
    master, *ranges = told
    data = access.feedback(motor_id, int(master or 0))
    if data is None:
        return None
    p_max, v_max, t_max = (float(limit or 0.0) for limit in ranges)
    return MotorState(*unpack_feedback((p_max, v_max, t_max, *_UNUSED_GAINS), data)[1:])


def require_alone(access: RegisterAccess, motor_id: int, name: str) -> None:
    """Check that exactly one motor has this id, and that its replies have the id in its MST_ID register.

    Raises:
        MotorError: no motor or two motors have the id, or replies have another id than MST_ID.
    """
    found = access.find(motor_id)
    if not found:
        raise MotorError(
            f"{access.channel}: {name} (id {motor_id}) does not answer; check its power and cable, and look for it "
            "under another id (yam-motors scan)"
        )
    _require_one(access, motor_id, len(found))
    (reply,) = found
    if reply.identifier != reply.value:
        raise MotorError(
            f"{access.channel}: {name} (id {motor_id}) answers as 0x{reply.identifier:X}, but its MST_ID is "
            f"0x{int(reply.value):X}; nothing was changed. Switch the arm's power off and on, and try again"
        )


def _require_one(access: RegisterAccess, motor_id: int, answered: int) -> None:
    if answered > 1:
        raise MotorError(
            f"{access.channel}: {answered} motors answer to id {motor_id}; nothing was changed. Unplug all but one of "
            "them, and give that one its own id (yam-motors set-id)"
        )


def require_limp(access: RegisterAccess, motor_id: int, name: str) -> None:
    """Check that a motor is limp, so that changes are safe. Raises MotorError: it is energised, faulty or silent."""
    state = read_state(access, motor_id)
    if state is None:
        raise MotorError(f"{access.channel}: {name} (id {motor_id}) gives no feedback; nothing was changed")
    if state.fault == Fault.NORMAL:
        raise MotorError(
            f"{access.channel}: {name} (id {motor_id}) is energised; nothing was changed. Motors are set up while they "
            "are limp: end the program that drives the arm, which lands it, or support the arm and switch its power "
            "off and on"
        )
    if state.fault != Fault.DISABLED:
        raise MotorError(
            f"{access.channel}: {name} (id {motor_id}) reports {fault_text(state.fault)}; nothing was changed. See to "
            "the fault, switch the arm's power off and on, and try again"
        )


def equal(register: Register, one: float | int, other: float | int) -> bool:
    """Return whether both values are encoded as the same four bytes of the register."""
    return encode_value(register, one) == encode_value(register, other)


def changes(
    before: Mapping[Register, float | int], after: Mapping[Register, float | int]
) -> dict[Register, tuple[float | int, float | int | None]]:
    """Compare contents except measurements: register -> (old value, new value; None: no longer reported)."""
    found: dict[Register, tuple[float | int, float | int | None]] = {}
    for register, old in before.items():
        new = after.get(register)
        if register not in MEASURED and (new is None or not equal(register, old, new)):
            found[register] = old, new
    return found


def put(access: RegisterAccess, wanted: Mapping[int, Contents]) -> dict[int, Contents]:
    """Set registers of motors in RAM; registers that already have their value are not written.

    Args:
        wanted: motor id -> register values.

    Returns:
        Motor id -> previous values of the registers that were written.

    Raises:
        MotorError, BusError: writing a value failed. Earlier writes are undone, or the message lists them.
    """
    written: dict[int, Contents] = {motor_id: {} for motor_id in wanted}
    try:
        for motor_id, values in wanted.items():
            for register, value in values.items():
                old = access.read(motor_id, register)
                if old is None:
                    raise MotorError(f"{access.channel}: motor {motor_id} does not tell register {register.name}")
                if not equal(register, old, value):
                    written[motor_id][register] = old
                    access.write_and_check(motor_id, register, value)
    except (MotorError, BusError) as error:
        raise type(error)(f"{error}; {put_back(access, written) or 'nothing was changed'}") from error
    return written


def put_back(access: RegisterAccess, written: Mapping[int, Contents]) -> str:
    """Undo `put` where the motors reply; return a message that lists registers not restored, or ""."""
    left = []
    for motor_id, contents in written.items():
        for register, value in contents.items():
            try:
                access.write_and_check(motor_id, register, value)
            except (MotorError, BusError):
                left.append(f"{register.name} of motor {motor_id} (was {value:g})")
    return f"NOT PUT BACK: {', '.join(left)}; switch the power off and on, which undoes it" if left else ""


def store(access: RegisterAccess, motor_id: int) -> list[str]:
    """Store RAM in flash, and restore registers that storing changes.

    Some firmware, when it stores one register, resets others to their flash values. Those are written and stored
    again, as long as their number decreases each time.

    Returns:
        Names of the registers that were stored again.

    Raises:
        MotorError: the motor fell silent or did not confirm, or registers changed permanently; the message lists them.
    """
    before = read_contents(access, motor_id)
    again: dict[Register, None] = {}
    lost: Mapping[Register, object] = before
    while lost:
        confirmed = access.store(motor_id)
        after = read_contents(access, motor_id)
        if not after:
            raise MotorError(
                f"{access.channel}: motor {motor_id} fell silent while it stored its registers; what its flash holds "
                "is not known. Switch the arm's power off and on, then look at it (yam-motors diff)"
            )
        if not confirmed:
            raise MotorError(
                f"{access.channel}: motor {motor_id} did not confirm storing its registers; its RAM is as it was. "
                "Store it again (yam-motors store)"
            )
        found = changes(before, after)
        if not found:
            return [register.name for register in again]
        fixed = {register: old for register, (old, _) in found.items() if register.writable}
        if len(found) >= len(lost) or len(fixed) < len(found):
            listing = ", ".join(f"{r.name} from {old:g} to {_shown(new)}" for r, (old, new) in found.items())
            raise MotorError(
                f"{access.channel}: storing the registers of motor {motor_id} changed others: {listing}; energise "
                "nothing before they are right again"
            )
        lost = found
        again |= dict.fromkeys(found)
        put(access, {motor_id: fixed})
    return []


def _shown(value: float | int | None) -> str:
    return "not told" if value is None else f"{value:g}"
