"""Giving a motor other CAN ids: it is followed from one to the other, and goes back when it does not arrive."""

import argparse

from lerobot_robot_yam.commands.lib.arm_command import tell
from lerobot_robot_yam.commands.lib.motor.motor_bench import MotorBench
from lerobot_robot_yam.commands.lib.motor.motor_changes import WRITING, confirm
from lerobot_robot_yam.commands.lib.motor.motor_dump import kept_until_stored
from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.motor_memory import store
from lerobot_robot_yam.damiao.tables import REGISTER_ID
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.system.signals import finished_first

_ANSWERS_MOST = 0xFF
_ATTEMPTS = 3


def set_id(args: argparse.Namespace, bench: MotorBench, old: int, new: int, answers: int) -> int:
    """`yam-motors set-id`: the only motor with id `old` listens on `new` and answers as `answers`, stored."""
    if not 0 <= old < REGISTER_ID:
        raise ConfigError(f"{old} is no CAN id of a motor")
    if new not in MOTOR_IDS:
        raise ConfigError(f"id {new} cannot be used: feedback tells ids 1 to 15 apart")
    if answers and not MOTOR_IDS[-1] < answers <= _ANSWERS_MOST:
        raise ConfigError(f"a motor cannot answer as {answers}: ids 1 to 15 are for commands; give 0, or 16 to 255")
    bench.require_settable([old])
    held = bench.contents(old)
    if (old, int(held[Register.MST_ID])) == (new, answers):
        tell("the motor has these ids already; nothing was written")
        return 0
    _require_free(bench, old, new, answers)
    question = f"give motor {old} (answers as {int(held[Register.MST_ID])}) id {new}, answering as {answers}"
    confirm(args, bench, [old], "set-id", question)
    with finished_first(WRITING):
        with kept_until_stored(bench.channel, {old: held}):
            _move(bench, old, new, int(held[Register.MST_ID]), answers)
            again = store(bench.access, new)
            _verify(bench, new, answers)
        for name in again:
            tell(f"note: storing put {name} back; it was written and stored again")
        tell(f"motor {old} is now motor {new} and answers as {answers}; stored and read back")
        tell("Switch the arm's power off and on, and run yam-motors scan: it shows whether the motor has kept it")
    return 0


def _require_free(bench: MotorBench, old: int, new: int, answers: int) -> None:
    for can_id in MOTOR_IDS:
        found = [] if can_id == old else bench.access.find(can_id)
        if found and can_id == new:
            raise MotorError(f"{bench.channel}: another motor has id {new} already; nothing was changed")
        if answers and any(reply.value == answers for reply in found):
            raise MotorError(f"{bench.channel}: motor {can_id} answers as {answers} already; nothing was changed")


def _move(bench: MotorBench, old: int, new: int, answered: int, answers: int) -> None:
    """Change both ids in RAM, or neither.

    Raises:
        MotorError: it did not take them; the message says under which ids it is now.
    """
    access = bench.access
    try:
        access.write_and_check(old, Register.MST_ID, answers)
        for _ in range(_ATTEMPTS):
            if old == new or access.find(new):
                break
            access.write(old, Register.ESC_ID, new)
        _verify(bench, new, answers)
    except MotorError as error:
        where = next((can_id for can_id in (new, old) if access.find(can_id)), None)
        if where is None:
            raise MotorError(
                f"{error}. The motor does not answer any more; nothing was stored: switch its power off and on"
            ) from error
        if where == new != old:
            access.write(new, Register.ESC_ID, old)
        access.write(old, Register.MST_ID, answered)
        back = access.find(old)
        said = "it has its old ids again" if back and back[0].value == answered else "its ids are UNCLEAR"
        raise MotorError(f"{error}; {said}, nothing was stored: switch its power off and on") from error


def _verify(bench: MotorBench, new: int, answers: int) -> None:
    found = bench.access.find(new)
    held = [int(reply.value) for reply in found]
    if held != [answers] or bench.access.read(new, Register.ESC_ID) != new:
        raise MotorError(f"{bench.channel}: motor {new} answers {len(found)} times, as {held or 'nothing'}")
