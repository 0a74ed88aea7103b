"""Check of one channel: query the arm and measure its reply latency; if a session drives it, watch the session."""

import dataclasses
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig, passive_of
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.control.preflight.role import FIRST_IDS, are_wheels
from lerobot_robot_yam.damiao.motor_inspection import listen
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.round_trip import SLOW_S
from lerobot_robot_yam.doctor.check_encoders import handle_firmware, inspect_handle, inspect_passive
from lerobot_robot_yam.doctor.check_link import Link
from lerobot_robot_yam.doctor.check_motors import inspect_motors
from lerobot_robot_yam.doctor.check_rail import inspect_rail
from lerobot_robot_yam.doctor.check_session import driver_of, watch_session
from lerobot_robot_yam.doctor.kit.findings import Report, Section
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, BaseTarget, Examined
from lerobot_robot_yam.errors import ChannelInUseError, YamError
from lerobot_robot_yam.mobile.base_config import BASE, BaseConfig
from lerobot_robot_yam.state.records import lock_path
from lerobot_robot_yam.system.runtime_files import FileLock

_LISTEN_S = 0.3  # listening time for other drivers, s; longer than a session's 50 ms, to hear slow pollers, too
BIN_EDGES_MS = (0.3, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # upper edges of the histogram's bins, ms; one more bin follows
BLOCKS = "·▁▂▃▄▅▆▇█"
_LABELS = (*(f"≤{edge:g}" for edge in BIN_EDGES_MS), "more")
_TIMEOUT_S = 0.25
_GIVE_UP = 3  # consecutive lost replies after which a motor is skipped
_LOST_MAX = 0.01  # maximum tolerable share of lost replies
_TICK_MS = 4.0  # period of a control loop at 250 Hz, ms
_QUICKER = (
    "use another adapter; of a serial one, lower the latency timer: "
    "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB*/latency_timer"
)


def examine_channel(
    target: Examined, link: Link | None, samples: int, report: Report, say: Callable[[str], None]
) -> None:
    """Check one channel. `say` gets a line about the progress."""
    config = target.config
    row = {"channel": target.channel, **_parts(target), "examined": "asked"}
    report["channels"].rows.append(row)
    if isinstance(config, ArmConfig) and config.identity_path is not None and not Path(config.identity_path).exists():
        what = f"there is no arm binding {config.identity_path} (`identity_path`): no session will start"
        remedy = f"yam-identify {config.on_command_line} --bind {config.identity_path}"
        report["channels"].problem(target.channel, what, remedy)
    if link is not None and not link.usable:
        row["examined"] = "not asked: its interface is not usable"
        return
    lock = FileLock(lock_path(target.key), f"CAN channel {target.channel}")
    try:
        lock.acquire()
    except ChannelInUseError:
        row["examined"] = "watched: another process drives it"
        say(f"{target.channel}: another process drives it; watching")
        watch_session(target, driver_of(target), report["sessions"])
        return
    try:
        with open_bus(config) as bus:
            say(f"{target.channel}: listening")
            listen(bus, _LISTEN_S, range(1, 16), target.channel)
            row |= _parts(_ask(Questions(bus, target.channel), target, samples, report, say))
    except ChannelInUseError as error:
        row["examined"] = "not asked: a foreign driver is heard"
        report["channels"].problem(target.channel, str(error), "stop the program that drives this bus")
    except YamError as error:
        row["examined"] = "failed"
        repair = (link or Link(name=target.channel, up=True)).repair()
        remedy = repair if target.real else "check the names of channel and rig"
        report["channels"].problem(target.channel, str(error), remedy)
    finally:
        lock.release()


def _parts(target: Examined) -> dict[str, str | None]:
    if isinstance(target, BaseTarget):
        return {"arm": BASE, "gripper": None}
    return {"arm": target.config.arm, "gripper": target.config.gripper}


def _ask(questions: Questions, target: Examined, samples: int, report: Report, say: Callable[[str], None]) -> Examined:
    """Query all devices on the channel; return the target, with the detected gripper if none was declared."""
    channel = target.channel
    if isinstance(target, BaseTarget):
        if not _is_other(questions, target, report["channels"]):
            _ask_motors(questions, target, False, samples, report, say)
            if target.config.rail is not None:
                say(f"{channel}: reading the rail's switches")
                inspect_rail(target, questions.clock, report)
        return target
    if (passive := passive_of(target.config)) is not None:
        say(f"{channel}: listening to encoders")
        inspect_passive(questions, target, passive, report["passive_leaders"])
        return target
    firmware = handle_firmware(questions)
    if firmware is not None and not target.declared:
        target = dataclasses.replace(target, config=dataclasses.replace(target.config, gripper=LEADER_GRIPPER))
    hardware = target.hardware
    if hardware.joints and _is_other(questions, target, report["channels"]):
        config = target.config
        if target.declared:
            return target
        place = {name: getattr(config, name) for name in ("name", "channel", "interface", "can_options")}
        return _ask(questions, BaseTarget(BaseConfig(**place)), samples, report, say)
    present = _ask_motors(questions, target, firmware is not None, samples, report, say)
    if hardware.gripper.handle_encoder or firmware is not None:
        inspect_handle(questions, target, firmware, report["handles"])
    if firmware is not None and hardware.gripper.motor is None and not hardware.gripper.handle_encoder:
        what = f"a teaching handle answers, which gripper profile {target.config.gripper} does not have"
        report["handles"].problem(channel, what, f"name it --channel {channel}:{target.config.arm}:{LEADER_GRIPPER}")
    if not target.declared and present:
        what = f"its arm was not named; taken for arm {target.config.arm} with {target.config.gripper}"
        report["channels"].note(channel, what, f"name it: --channel {channel}:ARM:GRIPPER, or --config_path FILE")
    return target


def _is_other(questions: Questions, target: Examined, section: Section) -> bool:
    """Return whether the channel carries the other kind, arm or base; add a problem if the target was declared."""
    wheels = are_wheels([questions.register(can_id, Register.GR) for can_id in FIRST_IDS])
    if wheels is None or wheels == isinstance(target, BaseTarget):
        return False
    what, name = ("a mobile base", BASE) if wheels else ("an arm", "ARM:GRIPPER")
    remedy = f"name it: --channel {target.channel}:{name}; in a config, look for swapped channels"
    if target.declared:
        section.problem(target.channel, f"it carries {what}", remedy)
    return True


def _ask_motors(
    questions: Questions,
    target: Examined,
    handle: bool,
    samples: int,
    report: Report,
    say: Callable[[str], None],
) -> list[MotorSpec]:
    """Query all motors and measure their latency; return those that reply."""
    say(f"{target.channel}: asking {len(target.hardware.motors)} motors")
    present = inspect_motors(questions, target, handle, report["motors"])
    if samples and present:
        say(f"{target.channel}: {samples} questions to each of {len(present)} motors")
        measure_latency(questions, target, present, samples, report["latency"])
    return present


def measure_latency(
    questions: Questions, target: Examined, motors: Sequence[MotorSpec], samples: int, section: Section
) -> None:
    """Measure the reply latency of each motor with `samples` requests, motors in turn; add rows and findings."""
    answers: dict[int, list[float | None]] = {spec.can_id: [] for spec in motors}  # CAN id -> latencies, ms; None: lost
    for _ in range(samples):
        for can_id, told in answers.items():
            if told[-_GIVE_UP:] != [None] * _GIVE_UP:
                seconds = questions.round_trip_s(can_id, _TIMEOUT_S)
                told.append(None if seconds is None else seconds * 1e3)
    times_ms = {can_id: sorted(ms for ms in told if ms is not None) for can_id, told in answers.items()}
    quickest = min((ms for times in times_ms.values() if (ms := percentile(times, 0.5))), default=0.0)
    if quickest > 2e3 * SLOW_S:
        what = f"answers take {quickest:.1f} ms: the adapter is slow, and the arm is seen and commanded that much "
        section.problem(target.channel, f"{what}too late", _QUICKER)
    for spec in motors:
        _report_latency(target, spec, times_ms[spec.can_id], len(answers[spec.can_id]), section)


def _report_latency(target: Examined, spec: MotorSpec, times_ms: Sequence[float], asked: int, section: Section) -> None:
    counts, p99, lost = histogram(times_ms), percentile(times_ms, 0.99), asked - len(times_ms)
    section.rows.append(
        {
            "channel": target.channel,
            "id": spec.can_id,
            "name": spec.name,
            "samples": asked,
            "lost": lost,
            "p50_ms": percentile(times_ms, 0.5),
            "p99_ms": p99,
            "max_ms": round(times_ms[-1], 3) if times_ms else None,
            "histogram": bars(counts),
            "bin_edges_ms": list(BIN_EDGES_MS),
            "counts": counts,
        }
    )
    where = f"{target.channel} motor {spec.name} (id {spec.can_id})"
    if lost:
        add = section.problem if lost > _LOST_MAX * asked else section.warn
        remedy = "reseat the CAN cables of the arm and check the terminators (120 Ω at both ends)"
        add(where, f"{lost} of {asked} replies were lost", remedy)
    if p99 is not None and p99 > _TICK_MS:
        what = f"one reply in a hundred takes longer than {p99:.1f} ms; a tick of the loop is {_TICK_MS:g} ms"
        section.warn(where, what, "plug the adapter into a separate USB port, and stop what keeps the CPUs busy")


def histogram(times_ms: Sequence[float]) -> list[int]:
    """Count the times in each bin of `BIN_EDGES_MS`, and the times above the last edge."""
    edges = (float("-inf"), *BIN_EDGES_MS, float("inf"))
    return [sum(low < value <= high for value in times_ms) for low, high in pairwise(edges)]


def percentile(ordered: Sequence[float], share: float) -> float | None:
    """Return the value below which `share` of an ordered list lies, ms; None for an empty list."""
    return round(ordered[min(int(share * len(ordered)), len(ordered) - 1)], 3) if ordered else None


def bars(counts: Sequence[int]) -> str:
    """Draw a block per bin: height by count, width by label; a bin with any count shows at least a line."""
    most, steps = max(max(counts), 1), len(BLOCKS) - 1
    blocks = (BLOCKS[-(-count * steps // most)] for count in counts)
    return " ".join(block.ljust(len(label)) for block, label in zip(blocks, _LABELS, strict=True)).rstrip()
