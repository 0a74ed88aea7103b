"""Check of a running session from outside: reads the session's state block, and sends nothing on the bus."""

import math
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import passive_of
from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.targets import Examined, Target
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.base_records import BASE_STATE_DTYPE, BaseState
from lerobot_robot_yam.state.modes import ENERGISED, Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, lock_path, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock

_WATCH_S = 0.5
_LOST_MAX = 0.01  # maximum tolerable share of lost replies
_ENCODER_SILENT_MS = 100.0  # silence after which an encoder counts as lost, ms: 20 report periods
_LATE_SHARE = 0.9  # share of the configured rate below which a loop counts as slow
_REARM = "remove the cause, then re-arm the session or connect again"


def driver_of(target: Examined) -> str:
    """Return the holder of the channel's lock, such as "process 1234 (python -m …)"."""
    try:
        pid = lock_path(target.key).read_text().strip()
    except OSError:
        return "unknown"
    try:
        words = Path(f"/proc/{int(pid)}/cmdline").read_bytes().split(b"\0")
    except (OSError, ValueError):
        return f"process {pid or 'unknown'}"
    first, *rest = (word.decode(errors="replace") for word in words)
    program = " ".join([os.path.basename(first), *rest])
    return f"process {pid} ({program.strip()[:60]})"


def watch_session(target: Examined, driver: str, section: Section) -> None:
    """Add rows and findings about the session that drives the channel."""
    channel = target.channel
    try:
        dtype = STATE_DTYPE if isinstance(target, Target) else BASE_STATE_DTYPE
        block = SharedBlock(state_path(target.key), dtype, create=False)
    except (FileNotFoundError, StaleStateError) as error:
        section.rows.append({"channel": channel, "driver": driver, "mode": None})
        if isinstance(error, StaleStateError):
            section.problem(channel, f"its state cannot be read: {error}", f"end {driver}")
        else:
            what = f"is held by {driver}, which publishes no state (yet): nothing was asked"
            section.note(channel, what, "run yam-doctor again when that session runs or has ended")
        return
    try:
        first = block.read()
        time.sleep(_WATCH_S)
        record = block.read()
    except StaleStateError as error:
        section.problem(channel, str(error), f"end {driver}")
        return
    finally:
        block.close()
    if first is None or record is None:
        section.note(channel, f"is held by {driver}, which has not begun", "run yam-doctor again")
        return
    _report(target, driver, first, record, time.monotonic(), section)


def _report(target: Examined, driver: str, first: np.ndarray, record: np.ndarray, now: float, section: Section) -> None:
    channel = target.channel
    arm = target if isinstance(target, Target) else None
    state = BaseState(record) if arm is None else ArmState(record.tobytes())
    age = now - float(record["stamp_s"])
    ticks, elapsed = int(record["tick"]) - int(first["tick"]), float(record["stamp_s"]) - float(first["stamp_s"])
    rate = ticks / elapsed if elapsed > 0 else 0.0
    head = {
        "channel": channel,
        "driver": driver,
        "mode": state.mode.name.lower(),
        "rate_hz": round(rate, 1),
        "age_ms": round(age * 1e3, 1),
        "message": state.message,
    }
    lost_before = first["lost"][_slots(target)].tolist()
    for row, before in zip(_motor_rows(target, record, now), lost_before, strict=True):
        if passive_of(target.config) is not None:  # joints have encoders, but no motors
            row["state"] = row["fault"] = None
            _check_encoder(channel, row, section)
        else:
            _check_motor(channel, row, state.mode, row["lost"] - before, ticks, section)
        section.rows.append({**head, **row})
    what = f"is driven by {driver}: watched, nothing was asked"
    section.note(channel, what, "end that session to have registers and latencies read")
    if state.mode is not Mode.OFF and age > target.config.max_state_age_s:
        what = f"its control loop has published nothing for {age:.2f} s"
        section.problem(channel, what, f"hold the {target.noun} by hand, then end {driver}")
    elif state.mode in (Mode.FAULT, Mode.STOPPED):
        what = f"is in {state.mode.name.lower()}: {state.message or 'no reason given'}"
        stopped = "look at the arms, then: yam-estop release"
        section.problem(channel, what, stopped if state.mode is Mode.STOPPED else _REARM)
    elif (
        state.mode is not Mode.OFF
        and (arm is None or arm.calibration)
        and 0 < rate < target.config.rate_hz * _LATE_SHARE
    ):
        what = f"its control loop makes {rate:.0f} instead of {target.config.rate_hz:g} ticks a second"
        section.warn(channel, what, "stop what keeps the CPUs busy (top), or lower rate_hz")
    silent = isinstance(state, ArmState) and state.trigger is None
    if arm is not None and arm.hardware.gripper.handle_encoder and state.mode in ENERGISED and silent:
        what = "the teaching handle is silent"
        section.problem(f"{channel} teaching handle", what, "check the handle's cable")


def _motor_rows(target: Examined, record: np.ndarray, now: float) -> list[dict[str, Any]]:
    """Return a row per motor of the profile; without a config, the session may drive fewer motors."""
    fields = ("motor_stamp_s", "fault", "lost", "temp_mos_c", "temp_rotor_c")
    columns = (target.hardware.motors, *(record[field][_slots(target)].tolist() for field in fields))
    return [
        {
            "name": spec.name,
            "id": spec.can_id,
            "state": fault_text(fault) if math.isfinite(stamp) else None,
            "fault": fault,
            "motor_age_ms": round((now - stamp) * 1e3, 1) if math.isfinite(stamp) else None,
            "lost": lost,
            "temp_mos_c": _finite(mos),
            "temp_rotor_c": _finite(rotor),
        }
        for spec, stamp, fault, lost, mos, rotor in zip(*columns, strict=True)
    ]


def _slots(target: Examined) -> Any:
    """Return the index of the motors in the fields of a record."""
    return target.hardware.slots if isinstance(target, Target) else slice(target.hardware.n)


def _check_encoder(channel: str, row: dict[str, Any], section: Section) -> None:
    age_ms = row["motor_age_ms"]
    if age_ms is None or age_ms > _ENCODER_SILENT_MS:
        what = "its encoder has not been heard" + ("" if age_ms is None else f" for {age_ms / 1e3:.1f} s")
        section.problem(f"{channel} {row['name']}", what, "check power and cable of the passive leader")


def _check_motor(channel: str, row: dict[str, Any], mode: Mode, lost: int, ticks: int, section: Section) -> None:
    """Check one motor; `lost` of `ticks` replies were lost while the session was watched."""
    if row["motor_age_ms"] is None:
        return  # the session does not drive this motor: the channel's arm was not named
    where = f"{channel} motor {row['name']} (id {row['id']})"
    if row["fault"] not in (Fault.DISABLED, Fault.NORMAL):
        section.problem(where, f"reports {row['state']}", _REARM)
    elif row["fault"] == Fault.DISABLED and mode in ENERGISED - {Mode.FAULT}:
        section.problem(where, "is disabled in a running session", "connect again")
    if lost > _LOST_MAX * ticks:  # only a warning: the session itself reports lost motors
        what = f"{lost} of {ticks} replies were lost while it was watched"
        section.warn(where, what, "reseat the CAN cables of the arm and check the terminators (120 Ω at both ends)")


def _finite(value: float) -> float | None:
    return round(float(value), 1) if math.isfinite(value) else None
