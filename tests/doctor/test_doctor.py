"""The command on a virtual rig: healthy, with seeded defects, beside a live session; and what it puts on the wire."""

import json
import subprocess
import sys
import threading
import time

import can
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.estop import EmergencyStop
from lerobot_robot_yam.arm.state import lock_path
from lerobot_robot_yam.arm.yam_arm import YamArm
from lerobot_robot_yam.configs_command import config_path
from lerobot_robot_yam.damiao import bringup, encoder
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Opcode, Register, encode_write
from lerobot_robot_yam.damiao.tables import REGISTER_ID, Fault
from lerobot_robot_yam.doctor.command import main
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.bus import YamSimBus
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.runtime import FileLock

from .desk import Sysfs, examine, found, replay_tools

ARM = [MotorSpec(f"joint_{i + 1}", i + 1, kind) for i, kind in enumerate(["DM4340"] * 3 + ["DM4310"] * 3)]
MOTORS = [*ARM, MotorSpec("gripper", 7, "DM4310")]
FOLLOWER, LEADER = "follower_left", "leader_left"
LEADER_ARM = f"{LEADER}:yam:yam_teaching_handle"


@pytest.fixture(scope="module")
def rig():
    with running_rig(arms=[FOLLOWER, LEADER]) as rig:
        yield rig


@pytest.fixture
def sick(rig):
    """The rig, made well again after the test."""
    with can.Bus(interface="yam_sim", channel=FOLLOWER, rig=rig.name) as bus:
        chain = MotorChain(bus, MOTORS, channel=FOLLOWER)
        names = (Register.PMAX, Register.VMAX, Register.TMAX, Register.TIMEOUT, Register.CTRL_MODE, Register.GR)
        before = [(spec, r, chain.read_register(i, r)) for i, spec in enumerate(MOTORS) for r in names]
    yield rig
    for channel in (FOLLOWER, LEADER):
        rig.clear_faults(channel)
    rig.trigger(LEADER, 0.0)
    for spec, register, value in before:
        rig.fault(FOLLOWER, spec.name, "register", value, register=int(register))
        rig.fault(FOLLOWER, spec.name, "register", spec.can_id, register=int(Register.ESC_ID))
        rig.fault(FOLLOWER, spec.name, "register", spec.feedback_id, register=int(Register.MST_ID))
    for spec in MOTORS:
        rig.fault(FOLLOWER, spec.name, "nibble", int(Fault.OVERLOAD))
    with can.Bus(interface="yam_sim", channel=FOLLOWER, rig=rig.name) as bus:
        MotorChain(bus, MOTORS, channel=FOLLOWER).special(SpecialCommand.CLEAR)
    with can.Bus(interface="yam_sim", channel=LEADER, rig=rig.name) as bus:
        set_report_frequency(bus, 0)


def set_report_frequency(bus, hz):
    data = encoder.encode_report_frequency(hz)
    bus.send(can.Message(arbitration_id=encoder.REQUEST_ID, data=data, is_extended_id=False))


def virtual(rig, *channels, samples=2):
    arguments = ["--interface=yam_sim", f"--rig={rig.name}", f"--samples={samples}"]
    return [*arguments, *(f"--channel={channel}" for channel in channels)]


def test_a_healthy_rig(rig, capsys):
    status, report = examine(capsys, *virtual(rig, FOLLOWER, LEADER_ARM, samples=20))
    assert status == 0, report["findings"]
    assert report["healthy"] and report["counts"]["problem"] == 0
    assert [row["examined"] for row in report["channels"]] == ["asked", "asked"]
    motors = [row for row in report["motors"] if row["channel"] == FOLLOWER]
    assert [row["id"] for row in motors] == [1, 2, 3, 4, 5, 6, 7]
    first = motors[0]
    assert (first["firmware"], first["hardware"], first["firmware_sub"]) == (5013, 10, 0)
    assert (first["position_max_rad"], first["velocity_max_rad_s"], first["torque_max_nm"]) == (12.5, 10, 28)
    assert (first["gear_ratio"], first["timeout_s"], first["control_mode"], first["answers_on"]) == (40, 0.4, 1, 17)
    assert first["supply_v"] == 24 and first["fault"] == 0 and 30 < first["temp_rotor_c"] < 50
    (handle,) = report["handles"]
    assert (handle["firmware"], handle["report_frequency_hz"], handle["trigger"]) == ("2.4.0", 0, 0)
    assert len(report["latency"]) == 13
    for row in report["latency"]:
        assert row["samples"] == 20 and row["lost"] == 0 and sum(row["counts"]) == 20
        assert 0.2 < row["p50_ms"] <= row["p99_ms"] <= row["max_ms"]  # two frames take 0.26 ms of wire
    assert "granted to the control loop" in [row["what"] for row in report["host"]]


def test_the_plain_report(rig, capsys):
    assert main(virtual(rig, FOLLOWER)) == 0
    out, err = capsys.readouterr()
    for words in ("Motors", "joint_1", "DM4340", "Reply latency", "p99 ms", "This computer", "healthy: 0 problems"):
        assert words in out
    assert f"{FOLLOWER}: listening" in err


def test_a_run_config_and_the_installed_module(rig, tmp_path):
    path = tmp_path / "run.yaml"
    path.write_text(
        f"robot: {{type: yam_follower, interface: yam_sim, channel: {FOLLOWER}, gripper_stops_rad: [3.25, -3.3]}}\n"
        f"teleop: {{type: yam_leader, interface: yam_sim, channel: {LEADER}, can_options: {{operator: nobody}}}}\n"
    )
    command = [sys.executable, "-m", "lerobot_robot_yam.doctor.command", f"--config_path={path}", f"--rig={rig.name}"]
    done = subprocess.run([*command, "--samples=1", "--json"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert [row["gripper"] for row in report["channels"]] == ["linear_4310", "yam_teaching_handle"]
    assert report["gripper_calibration"][0]["state"] == "configured"


def test_the_shipped_sim_config_is_healthy(capsys):
    with running_rig() as rig:
        status, report = examine(
            capsys, f"--config_path={config_path('sim/record')}", f"--rig={rig.name}", "--samples=1"
        )
        assert status == 0, report["findings"]
        assert len(report["channels"]) == 4


# What is put on the wire

HARMLESS = {Opcode.READ, Opcode.REFRESH}
HANDLE_QUESTIONS = {encoder.OP_REPORT, encoder.OP_VERSION, encoder.OP_READ_EEPROM}


@pytest.mark.parametrize("ill", [False, True])
def test_nothing_but_questions_is_sent(sick, capsys, ill):
    """Seen by the rig, and heard in full by another client of each channel."""
    if ill:  # nor when there is something to complain about
        sick.fault(FOLLOWER, "joint_2", "silent")
        sick.fault(FOLLOWER, "joint_4", "nibble", int(Fault.COMMUNICATION_LOST))
        sick.fault(FOLLOWER, "joint_5", "register", 0, register=int(Register.TIMEOUT))
        sick.fault(LEADER, None, "handle_silent")
    buses = [can.Bus(interface="yam_sim", channel=channel, rig=sick.name) for channel in (FOLLOWER, LEADER)]
    heard = []
    stop = threading.Event()

    def listen(bus):
        while not stop.is_set():
            message = bus.recv(0.05)
            if message is not None:
                heard.append((message.arbitration_id, bytes(message.data)))

    threads = [threading.Thread(target=listen, args=(bus,)) for bus in buses]
    for channel in (FOLLOWER, LEADER):
        sick.trace_start(channel)
    for thread in threads:
        thread.start()
    try:
        status, _ = examine(capsys, *virtual(sick, FOLLOWER, LEADER_ARM, samples=10))
        time.sleep(0.2)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
        for bus in buses:
            bus.shutdown()
    assert status == int(ill)
    traces = {channel: sick.trace(channel) for channel in (FOLLOWER, LEADER)}
    assert len(traces[FOLLOWER]) > 7 * 15 and len(traces[LEADER]) > 6 * 15
    for channel, trace in traces.items():
        # No motor id (1 …), no 0x100 + id, no 0x200 + id: neither an enable nor any motion.
        assert {identifier for _, _, identifier, _ in trace} <= {REGISTER_ID, encoder.REQUEST_ID}, channel
    questions = [data for identifier, data in heard if identifier == REGISTER_ID]
    assert len(questions) == sum(i == REGISTER_ID for trace in traces.values() for _, _, i, _ in trace)
    assert {data[2] for data in questions} == HARMLESS
    handle = [data for identifier, data in heard if identifier == encoder.REQUEST_ID and data[0] == 0xFF]
    assert handle and {data[1] for data in handle} <= HANDLE_QUESTIONS
    for channel in (FOLLOWER, LEADER):
        assert not any(motor["enabled"] for motor in sick.state()["arms"][channel]["motors"].values())


# Seeded defects of arms

DEFECTS = {
    "missing motor": (
        lambda rig: rig.fault(FOLLOWER, "joint_3", "silent"),
        ("joint_3 (id 3)", "no answer", "reseat the cable between joint_2 and joint_3"),
    ),
    "arm without power": (
        lambda rig: rig.fault(FOLLOWER, None, "silent"),
        (FOLLOWER, "none of the 7 motors answers", "switch the arm's power on"),
    ),
    "wrong time-out": (
        lambda rig: rig.fault(FOLLOWER, "joint_1", "register", 20000, register=int(Register.TIMEOUT)),
        ("joint_1 (id 1)", "TIMEOUT is 20000 instead of 8000", "send 7FF#01005509401F0000, then 7FF#0100AA01"),
    ),
    "time-out off": (
        lambda rig: rig.fault(FOLLOWER, "joint_1", "register", 0, register=int(Register.TIMEOUT)),
        ("joint_1 (id 1)", "never switches itself off", "send 7FF#01005509401F0000"),
    ),
    "wrong range": (
        lambda rig: rig.fault(FOLLOWER, "joint_5", "register", 12.566, register=int(Register.PMAX)),
        ("joint_5 (id 5)", "PMAX is 12.566 instead of 12.5", "send 7FF#0500551500004841"),
    ),
    "wrong mode": (
        lambda rig: rig.fault(FOLLOWER, "joint_2", "register", 2, register=int(Register.CTRL_MODE)),
        ("joint_2 (id 2)", "CTRL_MODE is 2 instead of 1", "send 7FF#0200550A01000000"),
    ),
    "wrong answering id": (
        lambda rig: rig.fault(FOLLOWER, "joint_6", "register", 0x40, register=int(Register.MST_ID)),
        ("joint_6 (id 6)", "MST_ID is 64 instead of 22", "send 7FF#0600550716000000"),
    ),
    "another type": (
        lambda rig: rig.fault(FOLLOWER, "gripper", "register", 7, register=int(Register.GR)),
        ("gripper (id 7)", "gear ratio is 7 (DM3507) instead of 10", "--channel follower_left:ARM:GRIPPER"),
    ),
    "duplicate id": (
        lambda rig: rig.fault(FOLLOWER, "joint_4", "duplicate"),
        ("joint_4 (id 4)", "answers twice", "unplug joint_4"),
    ),
    "wrong id": (
        lambda rig: rig.fault(FOLLOWER, "joint_4", "register", 9, register=int(Register.ESC_ID)),
        ("motor id 9", "the profile does not have", "if it is joint_4: send 7FF#0900550804000000, then 7FF#04005507"),
    ),
    "over-temperature": (
        lambda rig: rig.fault(FOLLOWER, "gripper", "nibble", int(Fault.ROTOR_OVER_TEMPERATURE)),
        ("gripper (id 7)", "0xC coil too hot", "let the motor cool down"),
    ),
    "communication lost": (
        lambda rig: rig.fault(FOLLOWER, "joint_1", "nibble", int(Fault.COMMUNICATION_LOST)),
        ("joint_1 (id 1)", "0xD communication lost", "connect again"),
    ),
    "lost replies": (
        lambda rig: rig.fault(FOLLOWER, "joint_2", "loss_rate", 0.4),
        ("joint_2 (id 2)", "replies were lost", "CAN cables"),
    ),
    "silent handle": (
        lambda rig: rig.fault(LEADER, None, "handle_silent"),
        (f"{LEADER} teaching handle", "does not answer", "check the handle's cable"),
    ),
    "squeezed beyond its travel": (
        lambda rig: rig.trigger(LEADER, 1.0),
        (f"{LEADER} teaching handle", "it is squeezed, or its zero is wrong", "send 50E#FF00"),
    ),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_found_and_its_remedy_named(sick, capsys, defect):
    seed, (where, what, remedy) = DEFECTS[defect]
    seed(sick)
    samples = 12 if defect == "lost replies" else 0
    channel = LEADER_ARM if where.startswith(LEADER) else FOLLOWER
    status, report = examine(capsys, *virtual(sick, channel, samples=samples))
    severity = "warning" if defect.startswith("squeezed") else "problem"
    findings = found(report, severity, where, what)
    assert len(findings) == 1, report["findings"]
    assert remedy in findings[0]["remedy"]
    assert status == (severity == "problem")
    # and nothing else: one defect is not reported as several
    others = [f for f in report["findings"] if f["severity"] == "problem" and f not in findings]
    assert [f["where"] for f in others] == ([f"{FOLLOWER} motor joint_4 (id 4)"] if defect == "wrong id" else [])


def test_a_handle_that_reports_by_itself(sick, capsys):
    with can.Bus(interface="yam_sim", channel=LEADER, rig=sick.name) as bus:
        set_report_frequency(bus, 100)
        status, report = examine(capsys, *virtual(sick, LEADER_ARM))
        assert status == 1
        (problem,) = found(report, "problem", f"{LEADER} teaching handle", "by itself at 100 Hz")
        assert problem["remedy"] == f"send 50E#FF0100 on {LEADER}"
        assert report["handles"][0]["report_frequency_hz"] == 100
        while bus.recv(0.0) is not None:
            pass
        assert bus.recv(2.0) is not None  # it was left as it is


def test_a_motor_that_is_energised_without_a_driver(sick, capsys):
    with can.Bus(interface="yam_sim", channel=FOLLOWER, rig=sick.name) as bus:
        chain = MotorChain(bus, MOTORS[:1], channel=FOLLOWER)
        chain.write_register(0, Register.TIMEOUT, 0)
        chain.special(SpecialCommand.ENABLE)
    _, report = examine(capsys, *virtual(sick, FOLLOWER, samples=0))
    (problem,) = found(report, "problem", "joint_1", "energised although nobody drives it")
    assert "hold the arm by hand" in problem["remedy"]


def test_a_warm_motor(sick, capsys):
    sick.fault(FOLLOWER, "joint_2", "temperatures_c", [50, 92])
    status, report = examine(capsys, *virtual(sick, FOLLOWER, samples=0))
    assert status == 0
    assert found(report, "warning", "joint_2", "coil 92 °C; it switches itself off at 100 °C")


def test_a_leader_in_place_of_a_follower(rig, capsys):
    """Swapped cables."""
    status, report = examine(capsys, *virtual(rig, LEADER, samples=0))
    assert status == 1
    (problem,) = found(report, "problem", "gripper (id 7)", "a teaching handle answers")
    assert f"--channel {LEADER}:yam:yam_teaching_handle" in problem["remedy"]
    _, report = examine(capsys, *virtual(rig, f"{LEADER}:yam:no_gripper", samples=0))
    assert found(report, "problem", LEADER, "a teaching handle answers, which gripper profile no_gripper does not have")


def test_a_follower_in_place_of_a_leader(rig, capsys):
    status, report = examine(capsys, *virtual(rig, f"{FOLLOWER}:yam:yam_teaching_handle", samples=0))
    assert status == 1
    assert found(report, "problem", f"{FOLLOWER} motor id 7", "the profile does not have")
    assert found(report, "problem", f"{FOLLOWER} teaching handle", "does not answer")


def test_another_arm_than_the_profile_says(rig, capsys):
    _, report = examine(capsys, *virtual(rig, f"{FOLLOWER}:big_yam", samples=0))
    problems = found(report, "problem", "joint_1 (id 1)")
    assert len(problems) == 1 and "gear ratio is 40" in problems[0]["what"]


def test_a_channel_that_the_rig_does_not_have(rig, capsys):
    status, report = examine(capsys, *virtual(rig, "nowhere"))
    assert status == 1
    assert found(report, "problem", "nowhere", "nowhere")


WRONG = {
    Register.PMAX: 6.0,
    Register.VMAX: 5.0,
    Register.TMAX: 7.0,
    Register.TIMEOUT: 4000,
    Register.CTRL_MODE: 2,
    Register.MST_ID: 0x33,
    Register.GR: 25.0,
}


@pytest.mark.parametrize("register", WRONG, ids=lambda register: register.name)
def test_what_a_session_would_refuse_is_found(sick, capsys, register):
    """The doctor and `bringup.verify` agree on what a motor must hold."""
    sick.fault(FOLLOWER, "joint_4", "register", WRONG[register], register=int(register))
    with (
        can.Bus(interface="yam_sim", channel=FOLLOWER, rig=sick.name) as bus,
        pytest.raises(MotorError, match="joint_4"),
    ):
        bringup.verify(MotorChain(bus, MOTORS, channel=FOLLOWER))
    status, report = examine(capsys, *virtual(sick, FOLLOWER, samples=0))
    assert status == 1
    (problem,) = found(report, "problem", "joint_4")
    if register is not Register.GR:  # which is built in
        value = {Register.MST_ID: 20, Register.TIMEOUT: 8000, Register.CTRL_MODE: 1}.get(register)
        if value is not None:
            assert f"7FF#{encode_write(4, register, value).hex().upper()}" in problem["remedy"]


# Somebody drives the channel


def follower(rig):
    stops = [3.25, -3.3]
    options = {"rig": rig.name}
    return ArmConfig(name="left", channel=FOLLOWER, interface="yam_sim", can_options=options, gripper_stops_rad=stops)


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


def test_a_live_session_with_a_fault(sick, capsys):
    with YamArm(follower(sick)):
        sick.fault(FOLLOWER, "joint_5", "nibble", int(Fault.ROTOR_OVER_TEMPERATURE), sticky=True)
        time.sleep(0.3)
        status, report = examine(capsys, *virtual(sick, FOLLOWER))
        assert status == 1
        assert found(report, "problem", "joint_5 (id 5)", "0xC coil too hot")
        assert found(report, "problem", FOLLOWER, "is in fault")
        sick.clear_faults(FOLLOWER)


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


# Seeded defects of the computer


@pytest.mark.parametrize(
    "name, what, remedy",
    [
        ("down", "interface is down", "sudo ip link set can_follower_l up type can bitrate 1000000"),
        ("bus_off", "bus-off", "sudo ip link set can_follower_l down && "),
        ("bitrate", "500000", "sudo ip link set can_follower_l down && "),
        ("no_buffer", "no buffer space", "up txqueuelen 100 type can bitrate 1000000"),
    ],
)
def test_an_interface_in_a_bad_state_is_not_asked(tmp_path, monkeypatch, capsys, name, what, remedy):
    replay_tools(tmp_path, monkeypatch, name)
    for arguments in ([], ["--channel=can_follower_l"]):
        status, report = examine(capsys, *arguments, f"--sysfs={tmp_path}")
        assert status == 1
        (problem,) = found(report, "problem", "can_follower_l")
        assert what in problem["what"] and remedy in problem["remedy"]
        assert report["channels"][0]["examined"] == "not asked: its interface is not usable"


def test_a_computer_with_two_arms(rig, tmp_path, monkeypatch, capsys):
    """Nothing is said on the command line. The rig stands behind the interfaces that the tools show."""
    rename = {"can_follower_l": FOLLOWER, "can_leader_l": LEADER}
    replay_tools(tmp_path, monkeypatch, "healthy", rename)
    monkeypatch.setitem(can.interfaces.BACKENDS, "socketcan", (YamSimBus.__module__, YamSimBus.__name__))
    monkeypatch.setenv("YAM_RIG", rig.name)
    sysfs = Sysfs(tmp_path / "sys")
    sysfs.adapter(FOLLOWER, "1-2.1", serial="0001")
    sysfs.adapter(LEADER, "1-2.2", serial="0002")
    sysfs.realsense("video0", "2-1", "5000")
    status, report = examine(capsys, f"--sysfs={sysfs.root}", "--samples=1")
    assert status == 0, report["findings"]
    assert [row["state"] for row in report["interfaces"]] == ["ERROR-ACTIVE"] * 2
    assert [row["gripper"] for row in report["channels"]] == ["linear_4310", "yam_teaching_handle"]
    assert len(found(report, "note", "_left", "nobody has said what is on it")) == 2
    status, report = examine(capsys, f"--sysfs={sysfs.root}", f"--channel={LEADER_ARM}", "--samples=1")
    assert status == 0 and not found(report, "note", LEADER)
    rig.fault(FOLLOWER, "joint_1", "register", 1, register=int(Register.TIMEOUT))
    try:
        status, report = examine(capsys, f"--sysfs={sysfs.root}", f"--channel={FOLLOWER}", "--samples=1")
    finally:
        rig.fault(FOLLOWER, "joint_1", "register", 8000, register=int(Register.TIMEOUT))
    (problem,) = found(report, "problem", "joint_1")
    assert problem["remedy"] == (
        f"cansend {FOLLOWER} 7FF#01005509401F0000 && sleep 0.1 && cansend {FOLLOWER} 7FF#0100AA0100000000"
    )


def test_an_interface_that_is_not_there(tmp_path, monkeypatch, capsys):
    replay_tools(tmp_path, monkeypatch, "down")
    status, report = examine(capsys, "--channel=can_other", f"--sysfs={tmp_path}")
    assert status == 1 and report["channels"] == []
    (problem,) = found(report, "problem", "can_other", "there is no such interface")
    assert "the system shows can_follower_l" in problem["remedy"]


def test_adapters_with_one_serial_number_and_a_camera_on_usb_2(tmp_path, monkeypatch, capsys):
    replay_tools(tmp_path, monkeypatch, "generic_names")
    sysfs = Sysfs(tmp_path / "sys")
    sysfs.adapter("can0", "1-2.1", serial="0001")
    sysfs.adapter("can1", "1-2.2", serial="0001")
    sysfs.realsense("video0", "1-3", "480")
    status, report = examine(capsys, f"--sysfs={sysfs.root}", "--samples=0")
    assert status == 1
    for name, port in (("can0", "1-2.1:1.0"), ("can1", "1-2.2:1.0")):
        (problem,) = found(report, "problem", name, "same serial number (0001)")
        assert f'KERNELS=="{port}"' in problem["remedy"] and "90-yam-can.rules" in problem["remedy"]
    assert found(report, "problem", "RealSense", "480 Mbit/s")


def test_a_computer_without_can(tmp_path, monkeypatch, capsys):
    for tool in ("ip", "tc"):
        (tmp_path / tool).write_text("#!/bin/sh\necho '[{},{}]'\n")
        (tmp_path / tool).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    status, report = examine(capsys, f"--sysfs={tmp_path}")
    assert status == 1
    assert found(report, "problem", "this computer", "no CAN interface")


def test_a_computer_without_the_tools(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    _, report = examine(capsys, f"--sysfs={tmp_path}")
    (warning,) = found(report, "warning", "this computer", "state of the CAN interfaces is unknown")
    assert warning["remedy"] == "sudo apt install iproute2"


def test_a_latched_emergency_stop(rig, capsys):
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        status, report = examine(capsys, *virtual(rig, FOLLOWER, samples=0))
    finally:
        stop.release()
    assert status == 1
    (problem,) = found(report, "problem", "this computer", "a test")
    assert "yam-estop release" in problem["remedy"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["--interface=yam_sim"],
        ["--channel=a:b:c:d"],
        ["--channel=can0:no_such_arm"],
        ["--channel=can0", "--channel=can0"],
        ["--config_path=no_such_file.yaml"],
        ["--channel=can0", "--config_path=x.yaml"],
        ["--channel=can0", "--samples=-1"],
        ["--channel=can0", "--interface=yam_sim", "--rig=auto:nobody"],
    ],
)
def test_wrong_usage(arguments, capsys):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("yam-doctor: ")


def test_an_unknown_option_is_wrong_usage(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--no-such-option"])
    assert end.value.code == 2
    assert "usage" in capsys.readouterr().err
