"""A live table of an arm's limp motors. Feedback is asked for, which energises nothing."""

import argparse
import select
import sys
import time
from collections.abc import Iterator

from lerobot_robot_yam.commands.lib.arm_command import CLEAR_SCREEN, table
from lerobot_robot_yam.commands.lib.motor.motor_bench import MotorBench
from lerobot_robot_yam.damiao.settings.motor_memory import MotorState, read_state
from lerobot_robot_yam.damiao.tables import fault_text

_PERIOD_S = 0.2
_HEAD = ["motor", "id", "rad", "rad/s", "Nm", "stage °C", "coil °C", "state"]


def ticks(seconds: float | None, period_s: float) -> Iterator[None]:
    """At once and then every period, until the time has passed or Enter is pressed."""
    end = None if seconds is None else time.monotonic() + seconds
    terminal = sys.stdin.isatty()
    while True:
        yield
        if terminal and select.select([sys.stdin], [], [], period_s)[0]:
            sys.stdin.readline()
            return
        if not terminal:
            time.sleep(period_s)
        if end is not None and time.monotonic() >= end:
            return


def watch_motors(args: argparse.Namespace, bench: MotorBench) -> int:
    """`yam-motors watch`."""
    ids = bench.ids(args.motor)
    for _ in ticks(args.seconds, _PERIOD_S):
        rows = [[bench.name(can_id), str(can_id), *_cells(read_state(bench.access, can_id))] for can_id in ids]
        sys.stdout.write((CLEAR_SCREEN if sys.stdout.isatty() else "") + table(_HEAD, rows) + "\n")
        sys.stdout.flush()
    return 0


def _cells(state: MotorState | None) -> list[str]:
    if state is None:
        return ["?"] * 5 + ["no answer"]
    measured = (f"{state.position_rad:+.3f}", f"{state.velocity_rad_s:+.2f}", f"{state.torque_nm:+.2f}")
    return [*measured, str(state.temp_mos_c), str(state.temp_rotor_c), fault_text(state.fault)]
