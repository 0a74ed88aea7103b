"""Check of one channel: queries the arm if the channel is free, else watches the session that drives it."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import can

from lerobot_robot_yam.arm.config import passive_of
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.damiao.motor_inspection import listen
from lerobot_robot_yam.doctor.check_encoders import handle_firmware, inspect_handle, inspect_passive
from lerobot_robot_yam.doctor.check_latency import measure_latency
from lerobot_robot_yam.doctor.check_link import Link
from lerobot_robot_yam.doctor.check_motors import inspect_motors
from lerobot_robot_yam.doctor.check_session import driver_of, watch_session
from lerobot_robot_yam.doctor.kit.findings import Report
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, Target
from lerobot_robot_yam.errors import ChannelInUseError, YamError
from lerobot_robot_yam.state.records import lock_path
from lerobot_robot_yam.system.runtime_files import FileLock

_LISTEN_S = 0.3  # time of listening for other drivers, s; longer than a session's 50 ms, to hear slow pollers, too


def examine_channel(
    target: Target, link: Link | None, samples: int, report: Report, say: Callable[[str], None]
) -> None:
    config = target.config
    row = {"channel": target.channel, "arm": config.arm, "gripper": config.gripper, "examined": "asked"}
    report["channels"].rows.append(row)
    if config.identity_path is not None and not Path(config.identity_path).exists():
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
        bus = open_bus(config)
        try:
            asked = _ask(bus, target, samples, report, say)
            row["arm"], row["gripper"] = asked.config.arm, asked.config.gripper
        finally:
            bus.shutdown()
    except ChannelInUseError as error:
        row["examined"] = "not asked: a foreign driver is heard"
        report["channels"].problem(target.channel, str(error), "stop the program that drives this bus")
    except YamError as error:
        row["examined"] = "failed"
        report["channels"].problem(target.channel, str(error), _bus_remedy(target, link))
    finally:
        lock.release()


def _ask(bus: can.BusABC, target: Target, samples: int, report: Report, say: Callable[[str], None]) -> Target:
    """Query everything; returns the target with the gripper that was found."""
    channel = target.channel
    say(f"{channel}: listening")
    listen(bus, _LISTEN_S, range(1, 16), channel)
    questions = Questions(bus, channel)
    if (passive := passive_of(target.config)) is not None:
        say(f"{channel}: listening to encoders")
        inspect_passive(questions, target, passive, report["passive_leaders"])
        return target
    firmware = handle_firmware(questions)
    if firmware is not None and not target.declared:
        target = dataclasses.replace(target, config=dataclasses.replace(target.config, gripper=LEADER_GRIPPER))
    hardware = target.hardware
    say(f"{channel}: asking {len(hardware.motors)} motors")
    present = inspect_motors(questions, target, firmware is not None, report["motors"])
    if hardware.gripper.handle_encoder or firmware is not None:
        inspect_handle(questions, target, firmware, report["handles"])
    if firmware is not None and hardware.gripper.motor is None and not hardware.gripper.handle_encoder:
        what = f"a teaching handle answers, which gripper profile {target.config.gripper} does not have"
        report["handles"].problem(channel, what, f"name it --channel {channel}:{target.config.arm}:{LEADER_GRIPPER}")
    if not target.declared and present:
        what = f"its arm was not named; taken for arm {target.config.arm} with {target.config.gripper}"
        report["channels"].note(channel, what, f"name it: --channel {channel}:ARM:GRIPPER, or --config_path FILE")
    if samples and present:
        say(f"{channel}: {samples} questions to each of {len(present)} motors")
        measure_latency(questions, target, present, samples, report["latency"])
    return target


def _bus_remedy(target: Target, link: Link | None) -> str:
    """Remedy for a channel that failed while it was queried."""
    if not target.real:
        return "check the names of channel and rig"
    return (link or Link(name=target.channel, up=True)).repair()
