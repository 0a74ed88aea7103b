"""Changes that yam-motors makes: registers, timeouts and ids. A command changes all of its motors, or none."""

import argparse
import contextlib
import math
from collections.abc import Mapping, Sequence

from lerobot_robot_yam.commands.lib.dialogue import confirm_word, say, table, tell
from lerobot_robot_yam.commands.lib.motor.motor_bench import ANSWERS_BEYOND, SAFE_COUNTS, MotorBench
from lerobot_robot_yam.commands.lib.motor.motor_dump import kept_until_stored, load_dump, shown
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.motor_memory import Contents, changes, put, put_back, store
from lerobot_robot_yam.damiao.settings.register_ranges import check_value
from lerobot_robot_yam.damiao.tables import REGISTER_ID, TIMEOUT_COUNT_S
from lerobot_robot_yam.errors import ConfigError, MotorError, YamError
from lerobot_robot_yam.system.signals import finished_first

_WRITING = "registers are being written"
_NEVER = "never"
# Range of accepted timeouts, s: a shorter one trips at a late tick; with a longer one a dead arm holds too long.
_LEAST_S, _MOST_S = 0.05, 10.0
_ELSEWHERE = {
    Register.ESC_ID: "change it with yam-motors set-id",
    Register.MST_ID: "change it with yam-motors set-id",
    Register.TIMEOUT: "change it with yam-motors timeout",
    Register.CAN_BR: "it is left alone: at another bit-rate the motor is not heard any more",
}
_SCALES = frozenset({Register.PMAX, Register.VMAX, Register.TMAX, Register.CTRL_MODE})
_ANSWERS_MOST = 0xFF
_ATTEMPTS = 3  # attempts to write a motor's new id


def _confirm(args: argparse.Namespace, bench: MotorBench, ids: Sequence[int], word: str, question: str) -> None:
    """Require --yes, or that the user types `word`; after waiting for the user, check the motors again.

    Raises:
        ConfigError: the user typed something else.
        MotorError: in the meantime a motor was energised, or a second motor with the same id appeared.
    """
    if not args.yes:
        confirm_word(False, word, f"Type {word} to {question}:", "nothing was changed")
        bench.require_settable(ids)


# registers


def write_registers(args: argparse.Namespace, bench: MotorBench, settings: Contents) -> int:
    """Run `yam-motors write`: write the same settings to each of the chosen motors."""
    if not args.motor:
        raise ConfigError("name the motors to write to (--motor joint_3)")
    for register, value in settings.items():
        if register in _ELSEWHERE:
            raise ConfigError(f"register {register.name} is not written like this: {_ELSEWHERE[register]}")
        check_value(register, value)
    if not _SCALES.isdisjoint(settings):
        tell("HAZARD: these registers say what commands mean. Sessions refuse a motor in which they are not the type's")
    ids = bench.ids(args.motor)
    bench.require_settable(ids)
    return apply(args, bench, dict.fromkeys(ids, settings), "write", store_too=args.store)


def store_motors(args: argparse.Namespace, bench: MotorBench) -> int:
    """Run `yam-motors store`: copy the registers of motors from RAM to flash."""
    ids = bench.ids(args.motor)
    bench.require_settable(ids)
    named = ", ".join(map(bench.name, ids))
    _confirm(args, bench, ids, "store", f"store what {named} hold; flash bears a limited number of writes")
    kept = {can_id: bench.contents(can_id) for can_id in ids}
    with finished_first(_WRITING):
        with kept_until_stored(bench.channel, kept):
            _store_each(bench, dict.fromkeys(ids, {}))
        tell(f"stored, and read back: {named}")
    return 0


def restore_arm(args: argparse.Namespace, bench: MotorBench) -> int:
    """Run `yam-motors restore`: write and store the values of a dump that differ from the motors' values."""
    stored = load_dump(args.file)
    held = {can_id: bench.contents(can_id) for can_id in stored}
    wanted: dict[int, Contents] = {}
    for can_id, contents in stored.items():
        differing, name = changes(contents, held[can_id]), bench.name(can_id)
        if Register.GR in differing:
            raise MotorError(
                f"{bench.channel}: {name} (id {can_id}) is a motor of another type than in {args.file}; "
                "nothing was changed"
            )
        for register, (value, now) in differing.items():
            if now is None and register.writable:
                raise MotorError(f"{bench.channel}: {name} does not tell register {register.name}")
            if not register.writable or (register in _ELSEWHERE and register is not Register.TIMEOUT):
                why = _ELSEWHERE.get(register, "it is read-only")
                tell(f"note: {name}: {register.name} differs and stays as it is: {why}")
                continue
            check_value(register, value)
            if register is Register.TIMEOUT:
                _check_seconds(value * TIMEOUT_COUNT_S)
            wanted.setdefault(can_id, {})[register] = value
    bench.require_settable(list(stored))
    return apply(args, bench, wanted, "restore", store_too=True)


# timeouts


def timeout(args: argparse.Namespace, bench: MotorBench) -> int:
    """Run `yam-motors timeout`: show the motors' timeouts, or set them in RAM and flash."""
    if args.seconds is None:
        rows = []
        for can_id in bench.ids(args.motor):
            counts = bench.contents(can_id).get(Register.TIMEOUT, math.nan)
            rows.append([bench.name(can_id), f"{counts:g}", f"{counts * TIMEOUT_COUNT_S:g}" if counts else _NEVER])
        say(table(["motor", "counts of 50 µs", "seconds"], rows))
        return 0
    _check_seconds(args.seconds)
    ids = bench.ids(args.motor)
    bench.require_settable(ids)
    counts = round(args.seconds / TIMEOUT_COUNT_S)
    if counts != SAFE_COUNTS:
        tell(f"note: sessions refuse an arm whose time-out is not {SAFE_COUNTS * TIMEOUT_COUNT_S:g} s")
    status = apply(args, bench, {can_id: {Register.TIMEOUT: counts} for can_id in ids}, "timeout", store_too=True)
    tell("Switch the arm's power off and on: until then a motor may go by the old value")
    return status


def _check_seconds(seconds: float) -> None:
    if seconds and not _LEAST_S <= seconds <= _MOST_S:  # also refuses NaN
        raise ConfigError(
            f"the time-out is {seconds:g} s: give seconds, {_LEAST_S:g} to {_MOST_S:g}, or 0 for never. The register "
            f"counts 50 µs: its factory value of {SAFE_COUNTS} is {SAFE_COUNTS * TIMEOUT_COUNT_S:g} s"
        )


# writing and storing


def apply(
    args: argparse.Namespace, bench: MotorBench, wanted: Mapping[int, Contents], word: str, *, store_too: bool
) -> int:
    """Show the changes, ask, write, read back and store them. Values that a motor already holds are skipped.

    Raises:
        ConfigError: the user did not confirm.
        MotorError, BusError: a motor did not accept a value. Motors that were not yet stored are back at their old
            values, or the message names them.
    """
    held = {can_id: bench.contents(can_id) for can_id in wanted}
    new: dict[int, Contents] = {}
    rows = []
    for can_id, values in wanted.items():
        for register, (value, old) in changes(values, held[can_id]).items():
            new.setdefault(can_id, {})[register] = value
            rows.append([bench.name(can_id), register.name, str(shown(register, old)), str(shown(register, value))])
    if not new:
        tell("the motors hold that already; nothing was written")
        return 0
    tell(table(["motor", "register", "from", "to"], rows))
    if any(values.get(Register.TIMEOUT) == 0 for values in new.values()):
        word = _NEVER
        tell(
            "HAZARD: without a time-out a motor goes on with its last command for ever when its program or cable "
            "fails: an arm that pushes goes on pushing."
        )
    question = "write this" + (" and store it" if store_too else " to RAM, until the power is switched off")
    _confirm(args, bench, list(new), word, question)
    before = {can_id: held[can_id] for can_id in new}
    with finished_first(_WRITING):
        with kept_until_stored(bench.channel, before) if store_too else contextlib.nullcontext():
            written = put(bench.access, new)
            if store_too:
                _store_each(bench, written)
        tell("written, " + ("stored " if store_too else "") + "and read back")
    return 0


def _store_each(bench: MotorBench, written: Mapping[int, Contents]) -> None:
    """Store motor by motor. `written`: motor -> old values, which unstored motors get back if a store fails."""
    done: dict[int, list[str]] = {}
    for can_id in written:
        try:
            done[can_id] = store(bench.access, can_id)
        except YamError as error:
            rest = {other: old for other, old in written.items() if other not in (*done, can_id)}
            stored = f" Stored before that: {', '.join(map(bench.name, done))}." if done else ""
            left = put_back(bench.access, rest) or "The other motors are as before"
            raise MotorError(f"{error}.{stored} {left}") from error
    for can_id, again in done.items():  # print only after all stores: the terminal may be closed
        if again:
            tell(
                f"note: storing put other registers of {bench.name(can_id)} back; {', '.join(again)} was written and "
                "stored again"
            )


# ids


def set_id(args: argparse.Namespace, bench: MotorBench) -> int:
    """Run `yam-motors set-id`: give the only motor with the old id a new id and reply identifier, and store both."""
    old, new = args.old, args.new
    answers = new + ANSWERS_BEYOND if args.answers is None else args.answers
    if not 0 <= old < REGISTER_ID:
        raise ConfigError(f"{old} is no CAN id of a motor")
    if new not in MOTOR_IDS:
        raise ConfigError(f"id {new} cannot be used: feedback tells ids 1 to 15 apart")
    if answers and not MOTOR_IDS[-1] < answers <= _ANSWERS_MOST:
        raise ConfigError(f"a motor cannot answer as {answers}: ids 1 to 15 are for commands; give 0, or 16 to 255")
    bench.require_settable([old])
    held = bench.contents(old)
    answered = int(held[Register.MST_ID])
    if (old, answered) == (new, answers):
        tell("the motor has these ids already; nothing was written")
        return 0
    for can_id in MOTOR_IDS:
        found = [] if can_id == old else bench.access.find(can_id)
        if found and can_id == new:
            raise MotorError(f"{bench.channel}: another motor has id {new} already; nothing was changed")
        if answers and any(reply.value == answers for reply in found):
            raise MotorError(f"{bench.channel}: motor {can_id} answers as {answers} already; nothing was changed")
    question = f"give motor {old} (answers as {answered}) id {new}, answering as {answers}"
    _confirm(args, bench, [old], "set-id", question)
    with finished_first(_WRITING):
        with kept_until_stored(bench.channel, {old: held}):
            _move(bench, old, new, answered, answers)
            again = store(bench.access, new)
            _require_ids(bench, new, answers)
        for name in again:
            tell(f"note: storing put {name} back; it was written and stored again")
        tell(f"motor {old} is now motor {new} and answers as {answers}; stored and read back")
        tell("Switch the arm's power off and on, and run yam-motors scan: it shows whether the motor has kept it")
    return 0


def _move(bench: MotorBench, old: int, new: int, answered: int, answers: int) -> None:
    """Change a motor's id and reply identifier in RAM; if one of them fails, restore both.

    Raises:
        MotorError: the motor did not accept the ids; the message says whether the old ids were restored.
    """
    access = bench.access
    try:
        access.write_and_check(old, Register.MST_ID, answers)
        for _ in range(_ATTEMPTS):
            if old == new or access.find(new):
                break
            access.write(old, Register.ESC_ID, new)
        _require_ids(bench, new, answers)
    except MotorError as error:
        if old != new and access.find(new):
            access.write(new, Register.ESC_ID, old)
        access.write(old, Register.MST_ID, answered)
        back = [int(reply.value) for reply in access.find(old)]
        said = "it has its old ids again" if back == [answered] else "its ids are UNCLEAR"
        raise MotorError(f"{error}; {said}, nothing was stored: switch its power off and on") from error


def _require_ids(bench: MotorBench, new: int, answers: int) -> None:
    found = bench.access.find(new)
    held = [int(reply.value) for reply in found]
    if held != [answers] or bench.access.read(new, Register.ESC_ID) != new:
        raise MotorError(f"{bench.channel}: motor {new} answers {len(found)} times, as {held or 'nothing'}")
