"""What yam-motors changes: registers, dumps written back, time-outs. All motors of a command, or none of them."""

import argparse
import contextlib
import math
import sys
from collections.abc import Mapping, Sequence

from lerobot_robot_yam.commands.lib.arm_command import ask, table, tell
from lerobot_robot_yam.commands.lib.motor.motor_bench import SAFE_COUNTS, MotorBench
from lerobot_robot_yam.commands.lib.motor.motor_dump import differences, kept_until_stored, load_dump, shown
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.motor_memory import Contents, changes, put, store
from lerobot_robot_yam.damiao.settings.register_ranges import check_value
from lerobot_robot_yam.damiao.tables import TIMEOUT_COUNT_S
from lerobot_robot_yam.errors import BusError, ConfigError, MotorError, YamError
from lerobot_robot_yam.system.signals import finished_first

WRITING = "registers are being written"
_NEVER = "never"
_LEAST_S, _MOST_S = 0.05, 10.0  # a loop sends every 4 ms, but now and then late; beyond, an arm holds on for too long
_ELSEWHERE = {
    Register.ESC_ID: "change it with yam-motors set-id",
    Register.MST_ID: "change it with yam-motors set-id",
    Register.TIMEOUT: "change it with yam-motors timeout",
    Register.CAN_BR: "it is left alone: at another bit-rate the motor is not heard any more",
}
_SCALES = frozenset({Register.PMAX, Register.VMAX, Register.TMAX, Register.CTRL_MODE})


def confirm(args: argparse.Namespace, bench: MotorBench, ids: Sequence[int], word: str, question: str) -> None:
    """Go on only if the word is typed, or with --yes.

    Raises:
        ConfigError: another word is typed.
        MotorError: one of these motors has been energised, or joined by another, while the question waited.
    """
    if args.yes:
        return
    if ask(f"Type {word} to {question}:") != word:
        raise ConfigError("not confirmed; nothing was changed")
    bench.require_settable(ids)


def write_registers(args: argparse.Namespace, bench: MotorBench, settings: Contents) -> int:
    """`yam-motors write`: the same settings for each of the chosen motors."""
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
    return apply(args, bench, {can_id: settings for can_id in ids}, "write", store_too=args.store)


def store_motors(args: argparse.Namespace, bench: MotorBench) -> int:
    """`yam-motors store`: what RAM holds, to flash."""
    ids = bench.ids(args.motor)
    bench.require_settable(ids)
    named = ", ".join(map(bench.name, ids))
    confirm(args, bench, ids, "store", f"store what {named} hold; flash bears a limited number of writes")
    kept = {can_id: bench.contents(can_id) for can_id in ids}
    with finished_first(WRITING):
        with kept_until_stored(bench.channel, kept):
            _store_each(bench, dict.fromkeys(ids, {}))
        tell(f"stored, and read back: {named}")
    return 0


def restore_arm(args: argparse.Namespace, bench: MotorBench) -> int:
    """`yam-motors restore`: write back and store what differs from a file."""
    stored = load_dump(args.file)
    held = {can_id: bench.contents(can_id) for can_id in stored}
    wanted: dict[int, Contents] = {}
    for can_id, contents in stored.items():
        differing = changes(contents, held[can_id])
        if Register.GR in differing:
            raise MotorError(
                f"{bench.channel}: {bench.name(can_id)} (id {can_id}) is a motor of another type than in {args.file}; "
                "nothing was changed"
            )
        for register, (value, now) in differing.items():
            if now is None and register.writable:
                raise MotorError(f"{bench.channel}: {bench.name(can_id)} does not tell register {register.name}")
            if not register.writable or (register in _ELSEWHERE and register is not Register.TIMEOUT):
                where = _ELSEWHERE.get(register, "it is read-only")
                tell(f"note: {bench.name(can_id)}: {register.name} differs and stays as it is: {where}")
                continue
            check_value(register, value)
            if register is Register.TIMEOUT:
                _check_seconds(value * TIMEOUT_COUNT_S)
            wanted.setdefault(can_id, {})[register] = value
    bench.require_settable(list(stored))
    return apply(args, bench, wanted, "restore", store_too=True)


def show_timeout(args: argparse.Namespace, bench: MotorBench) -> int:
    """`yam-motors timeout` without a time."""
    rows = []
    for can_id in bench.ids(args.motor):
        counts = bench.contents(can_id).get(Register.TIMEOUT, math.nan)
        seconds = f"{counts * TIMEOUT_COUNT_S:g}" if counts else _NEVER
        rows.append([bench.name(can_id), f"{counts:g}", seconds])
    sys.stdout.write(table(["motor", "counts of 50 µs", "seconds"], rows) + "\n")
    return 0


def set_timeout(args: argparse.Namespace, bench: MotorBench, seconds: float) -> int:
    """`yam-motors timeout SECONDS`: in RAM and flash, read back."""
    _check_seconds(seconds)
    ids = bench.ids(args.motor)
    bench.require_settable(ids)
    counts = round(seconds / TIMEOUT_COUNT_S)
    if counts != SAFE_COUNTS:
        tell(f"note: sessions refuse an arm whose time-out is not {SAFE_COUNTS * TIMEOUT_COUNT_S:g} s")
    status = apply(args, bench, {can_id: {Register.TIMEOUT: counts} for can_id in ids}, "timeout", store_too=True)
    tell("Switch the arm's power off and on: until then a motor may go by the old value")
    return status


def _check_seconds(seconds: float) -> None:
    if seconds and not _LEAST_S <= seconds <= _MOST_S:  # not a number, too
        raise ConfigError(
            f"the time-out is {seconds:g} s: give seconds, {_LEAST_S:g} to {_MOST_S:g}, or 0 for never. The register "
            f"counts 50 µs: its factory value of {SAFE_COUNTS} is {SAFE_COUNTS * TIMEOUT_COUNT_S:g} s"
        )


def apply(
    args: argparse.Namespace, bench: MotorBench, wanted: Mapping[int, Contents], word: str, *, store_too: bool
) -> int:
    """Show what changes, ask, write it, read it back and store it. Values that a motor holds already are not written.

    Raises:
        ConfigError: not confirmed.
        MotorError, BusError: a motor did not take it. Those that had not been stored by then were put back, or the
            message names them.
    """
    held = {can_id: bench.contents(can_id) for can_id in wanted}
    new = {
        can_id: {r: value for r, (value, _) in changes(values, held[can_id]).items()}
        for can_id, values in wanted.items()
    }
    new = {can_id: values for can_id, values in new.items() if values}
    if not new:
        tell("the motors hold that already; nothing was written")
        return 0
    rows = [
        [bench.name(can_id), r.name, str(shown(r, held[can_id][r])) if r in held[can_id] else "?", str(shown(r, value))]
        for can_id, values in new.items()
        for r, value in values.items()
    ]
    tell(table(["motor", "register", "from", "to"], rows))
    if any(values.get(Register.TIMEOUT) == 0 for values in new.values()):
        word = _NEVER
        tell(
            "HAZARD: without a time-out a motor goes on with its last command for ever when its program or cable "
            "fails: an arm that pushes goes on pushing."
        )
    question = "write this" + (" and store it" if store_too else " to RAM, until the power is switched off")
    confirm(args, bench, list(new), word, question)
    before = {can_id: held[can_id] for can_id in new}
    kept = kept_until_stored(bench.channel, before) if store_too else contextlib.nullcontext()
    with finished_first(WRITING):
        with kept:
            written: dict[int, Contents] = {}
            try:
                for can_id, values in new.items():
                    written[can_id] = put(bench.access, can_id, values)
            except (MotorError, BusError) as error:
                raise type(error)(f"{error}{_put_back(bench, written)}") from error
            if store_too:
                _store_each(bench, written)
        differing = differences(bench.names, new, {can_id: bench.contents(can_id) for can_id in new})
        if differing:
            raise MotorError(f"{bench.channel}: read back, but not as written: {differing}")
        tell("written, " + ("stored " if store_too else "") + "and read back")
    return 0


def _store_each(bench: MotorBench, written: Mapping[int, Contents]) -> None:
    """Store motor by motor; `written` is what each held before, to put back where it does not come to that."""
    done: dict[int, list[str]] = {}
    for can_id in written:
        try:
            done[can_id] = store(bench.access, can_id)
        except YamError as error:
            rest = {other: old for other, old in written.items() if other not in (*done, can_id)}
            stored = f". Stored before that: {', '.join(map(bench.name, done))}" if done else ""
            raise MotorError(f"{error}{stored}{_put_back(bench, rest)}") from error
    for can_id, again in done.items():  # not before all are stored: the terminal may have gone
        if again:
            tell(
                f"note: storing put other registers of {bench.name(can_id)} back; {', '.join(again)} was written and "
                "stored again"
            )


def _put_back(bench: MotorBench, written: Mapping[int, Contents]) -> str:
    left = []
    for can_id, old in written.items():
        try:
            put(bench.access, can_id, old)
        except YamError:
            left.append(bench.name(can_id))
    if left:
        return f". NOT PUT BACK: {', '.join(left)}; switch the power off and on, which undoes what was not stored"
    return ". The other motors are as before" if written else ""
