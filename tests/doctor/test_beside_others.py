"""The doctor puts questions on the wire, and disturbs no other program that drives the channel."""

import threading
import time
from functools import partial

import can
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.registers import Opcode, Register
from lerobot_robot_yam.damiao.tables import REGISTER_ID, Fault
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.records import lock_path
from lerobot_robot_yam.system.runtime_files import FileLock
from tests.support.doctor_desk import FOLLOWER, LEADER, LEADER_ARM, MOTORS, examine, examine_arm, found, virtual
from tests.support.rigged import lockstep_rig

HARMLESS = {Opcode.READ, Opcode.REFRESH}
HANDLE_QUESTIONS = {handle_encoder.OP_REPORT, handle_encoder.OP_VERSION, handle_encoder.OP_READ_EEPROM}


desk = lockstep_rig(FOLLOWER, LEADER)


@pytest.mark.parametrize("ill", [False, True])
def test_nothing_but_questions_is_sent(desk, ill):
    """Seen by the rig, and heard in full by another client of each channel."""
    if ill:  # nor when there is something to complain about
        desk.fault(FOLLOWER, "joint_2", "silent")
        desk.fault(FOLLOWER, "joint_4", "nibble", int(Fault.COMMUNICATION_LOST))
        desk.fault(FOLLOWER, "joint_5", "register", 0, register=int(Register.TIMEOUT))
        desk.fault(LEADER, None, "handle_silent")
    traces, heard = {}, []
    for channel, arm in ((FOLLOWER, FOLLOWER), (LEADER, LEADER_ARM)):
        with can.Bus(interface="yam_lockstep", channel=channel, rig=desk.name) as bus:
            desk.trace_start(channel)
            status, _ = examine_arm(desk, arm, samples=10)
            desk.sleep(0.2)
            heard += [(message.arbitration_id, bytes(message.data)) for message in iter(partial(bus.recv, 0.0), None)]
        assert status == int(ill)
        traces[channel] = desk.trace(channel)
    assert len(traces[FOLLOWER]) > 7 * 15 and len(traces[LEADER]) > 6 * 15
    for channel, trace in traces.items():
        # No motor id (1 …), no 0x100 + id, no 0x200 + id: neither an enable nor any motion.
        assert {identifier for _, _, identifier, _ in trace} <= {REGISTER_ID, handle_encoder.REQUEST_ID}, channel
        assert not any(motor["enabled"] for motor in desk.state()["arms"][channel]["motors"].values())
    questions = [data for identifier, data in heard if identifier == REGISTER_ID]
    assert len(questions) == sum(i == REGISTER_ID for trace in traces.values() for _, _, i, _ in trace)
    assert {data[2] for data in questions} == HARMLESS
    handle = [data for identifier, data in heard if identifier == handle_encoder.REQUEST_ID and data[0] == 0xFF]
    assert handle and {data[1] for data in handle} <= HANDLE_QUESTIONS


def follower(rig):
    stops = [3.25, -3.3]
    options = {"rig": rig.name}
    return ArmConfig(name="left", channel=FOLLOWER, interface="yam_sim", can_options=options, gripper_stops_rad=stops)


@pytest.mark.long
def test_a_live_session_is_watched_and_not_disturbed(rig, capsys):
    with YamArm(follower(rig)) as arm:
        time.sleep(0.3)
        with can.Bus(interface="yam_sim", channel=FOLLOWER, rig=rig.name) as bus:
            status, report = examine(capsys, *virtual(rig, FOLLOWER))
            strangers = {m.arbitration_id for m in iter(lambda: bus.recv(0.0), None)} & {REGISTER_ID}
        assert not strangers
        assert status == 0, report["findings"]
        (channel,) = report["channels"]
        assert "watched" in channel["examined"]
        assert report["motors"] == [] and report["latency"] == []
        assert [row["name"] for row in report["sessions"]] == [spec.name for spec in MOTORS]
        first = report["sessions"][0]
        assert first["mode"] == "hold" and first["rate_hz"] > 50 and first["motor_age_ms"] < 250
        assert first["fault"] == Fault.NORMAL and "process" in first["driver"]
        assert found(report, "note", FOLLOWER, "is driven by process")
        assert arm.observe().fault == (1,) * 7


def test_a_live_leader_that_was_not_named(rig, capsys):
    leader = {"name": "left", "channel": LEADER, "interface": "yam_sim", "can_options": {"rig": rig.name}}
    with YamArm(ArmConfig(**leader, gripper="yam_teaching_handle", rate_hz=125.0)):
        time.sleep(0.3)
        status, report = examine(capsys, *virtual(rig, LEADER))
    assert status == 0 and not found(report, "warning", LEADER, "ticks a second")
    assert [row["state"] for row in report["sessions"]][6] is None


def test_a_live_session_with_a_fault(capsys):
    with running_rig(arms=[FOLLOWER]) as sick, YamArm(follower(sick)):
        sick.fault(FOLLOWER, "joint_5", "nibble", int(Fault.ROTOR_OVER_TEMPERATURE), sticky=True)
        time.sleep(0.3)
        status, report = examine(capsys, *virtual(sick, FOLLOWER))
        assert status == 1
        assert found(report, "problem", "joint_5 (id 5)", "0xC coil too hot")
        assert found(report, "problem", FOLLOWER, "is in fault")


def test_a_held_channel_without_a_state(rig, capsys):
    key = f"{rig.name}.{FOLLOWER}"
    with FileLock(lock_path(key), "the test"):
        status, report = examine(capsys, *virtual(rig, FOLLOWER))
    assert status == 0
    assert found(report, "note", FOLLOWER, "publishes no state")


def test_a_foreign_driver_is_heard_and_nothing_is_sent(rig, capsys):
    with can.Bus(interface="yam_sim", channel=FOLLOWER, rig=rig.name) as bus:
        chain, stop = MotorChain(bus, MOTORS, channel=FOLLOWER), threading.Event()

        def poll():
            while not stop.wait(0.005):
                chain.refresh()

        thread = threading.Thread(target=poll)
        thread.start()
        try:
            status, report = examine(capsys, *virtual(rig, FOLLOWER))
        finally:
            stop.set()
            thread.join()
        assert chain.foreign == {} and not chain.duplicates.any()
    assert status == 1
    (problem,) = found(report, "problem", FOLLOWER, "already being driven")
    assert problem["remedy"] == "stop the program that drives this bus"
