"""Enabling of motors in the loop, one per tick, with retries."""

from collections.abc import Generator, Sequence
from typing import Protocol

from lerobot_robot_yam.damiao.chain import CLEAR_REPEATS, ENABLE_PAUSE_S, MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import Fault

_ENABLE_ATTEMPTS = 4  # how often ENABLE is sent: a frame may get lost
_ENABLED_S = 0.01  # wait for a motor to report that it is enabled, s; the adapter's delay is added


class Sender(Protocol):
    """What sends the commands of a tick. instead: special commands in place of commands of the next tick."""

    chain: MotorChain
    instead: dict[int, SpecialCommand]


def enable(sender: Sender, motors: Sequence[int], clear: bool = False) -> Generator[None, None, list[int]]:
    """Enable motors, one per tick, with retries for lost frames; return the motors that do not reply.

    clear: whether to clear their faults first. Command no torque to these motors meanwhile.
    """
    chain, off = sender.chain, list(motors)
    for _ in range(CLEAR_REPEATS if clear and off else 0):
        sender.instead = dict.fromkeys(off, SpecialCommand.CLEAR)
        yield
    silent: list[int] = []
    for _ in range(_ENABLE_ATTEMPTS):
        if not off:
            break
        for motor in off:
            sender.instead, sent_s = {motor: SpecialCommand.ENABLE}, chain.clock.now()
            yield
            while chain.clock.now() < sent_s + ENABLE_PAUSE_S:
                yield
        until_s = sent_s + _ENABLED_S + 2.0 * chain.round_trip.one_way_s
        while off:  # checked last: a late tick has the replies, too
            silent = [i for i in off if chain.asked_s[i] < sent_s]
            off = [i for i in off if i in silent or chain.fault[i] != Fault.NORMAL]
            if not off or chain.clock.now() >= until_s:
                break
            yield
    return silent
