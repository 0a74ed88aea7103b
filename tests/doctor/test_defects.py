"""Seeded defects of arms: each is found, named, and its remedy said."""

import shlex

import can
import pytest

from lerobot_robot_yam.commands.motors import main as repair
from lerobot_robot_yam.damiao import motor_inspection
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.register_access import RegisterAccess
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import MotorError
from tests.support.doctor_desk import FOLLOWER, LEADER, LEADER_ARM, MOTORS, examine_arm, found
from tests.support.rigged import lockstep_rig

WHERE = "--interface yam_lockstep"
rig = lockstep_rig(FOLLOWER, LEADER)
DEFECTS = {
    "missing motor": (
        lambda rig: rig.fault(FOLLOWER, "joint_3", "silent"),
        ("joint_3 (id 3)", "no answer", "reseat the cable between joint_2 and joint_3"),
    ),
    "broken cable": (
        lambda rig: [rig.fault(FOLLOWER, name, "silent") for name in ("joint_5", "joint_6", "gripper")],
        ("joint_5 (id 5)", "nor from joint_6, gripper behind it", "reseat the cable between joint_4 and joint_5"),
    ),
    "arm without power": (
        lambda rig: rig.fault(FOLLOWER, None, "silent"),
        (FOLLOWER, "none of the 7 motors answers", "switch the arm's power on"),
    ),
    "wrong time-out": (
        lambda rig: rig.fault(FOLLOWER, "joint_1", "register", 20000, register=int(Register.TIMEOUT)),
        (
            "joint_1 (id 1)",
            "TIMEOUT is 20000 instead of 8000",
            f"yam-motors timeout --channel {FOLLOWER} {WHERE}",
        ),
    ),
    "time-out off": (
        lambda rig: rig.fault(FOLLOWER, "joint_1", "register", 0, register=int(Register.TIMEOUT)),
        ("joint_1 (id 1)", "never switches itself off", "--motor 1 0.4 (then switch the power off and on"),
    ),
    "wrong range": (
        lambda rig: rig.fault(FOLLOWER, "joint_5", "register", 12.566, register=int(Register.PMAX)),
        ("joint_5 (id 5)", "PMAX is 12.566 instead of 12.5", "--motor 5 PMAX=12.5 --store"),
    ),
    "wrong mode": (
        lambda rig: rig.fault(FOLLOWER, "joint_2", "register", 2, register=int(Register.CTRL_MODE)),
        ("joint_2 (id 2)", "CTRL_MODE is 2 instead of 1", "--motor 2 CTRL_MODE=1 --store"),
    ),
    "wrong answering id": (
        lambda rig: rig.fault(FOLLOWER, "joint_6", "register", 0x40, register=int(Register.MST_ID)),
        ("joint_6 (id 6)", "MST_ID is 64 instead of 22", f"yam-motors set-id --channel {FOLLOWER} {WHERE}"),
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
        ("motor id 9", "the profile does not have", f"if it is joint_4: yam-motors set-id --channel {FOLLOWER}"),
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
    "slow adapter": (
        lambda rig: rig.fault(FOLLOWER, None, "latency_s", 0.008),
        (FOLLOWER, "the adapter is slow", "use another adapter"),
    ),
    "silent handle": (
        lambda rig: rig.fault(LEADER, None, "handle_silent"),
        (f"{LEADER} teaching handle", "does not answer", "check the handle's cable"),
    ),
    "squeezed beyond its travel": (
        lambda rig: rig.trigger(LEADER, 1.0),
        (
            f"{LEADER} teaching handle",
            "it is squeezed, or its zero is wrong",
            f"yam-handle zero --channel {LEADER}",
        ),
    ),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_found_and_its_remedy_named(rig, defect):
    seed, (where, what, remedy) = DEFECTS[defect]
    seed(rig)
    samples = 12 if defect in ("lost replies", "slow adapter") else 0
    channel = LEADER_ARM if where.startswith(LEADER) else FOLLOWER
    status, report = examine_arm(rig, channel, samples)
    severity = "warning" if defect.startswith("squeezed") else "problem"
    findings = found(report, severity, where, what)
    assert len(findings) == 1, report["findings"]
    assert remedy in findings[0]["remedy"]
    assert status == (severity == "problem")
    # and nothing else: one defect is not reported as several
    others = [f for f in report["findings"] if f["severity"] == "problem" and f not in findings]
    assert [f["where"] for f in others] == ([f"{FOLLOWER} motor joint_4 (id 4)"] if defect == "wrong id" else [])


def test_a_motor_that_is_energised_without_a_driver(rig):
    with can.Bus(interface="yam_lockstep", channel=FOLLOWER, rig=rig.name) as bus:
        chain = MotorChain(bus, MOTORS[:1], channel=FOLLOWER)
        RegisterAccess(bus, FOLLOWER).write(MOTORS[0].can_id, Register.TIMEOUT, 0)
        chain.special(SpecialCommand.ENABLE)
    _, report = examine_arm(rig, FOLLOWER)
    (problem,) = found(report, "problem", "joint_1", "energised although no session drives it")
    assert "hold it by hand" in problem["remedy"]


def test_a_warm_motor(rig):
    rig.fault(FOLLOWER, "joint_2", "temperatures_c", [50, 92])
    status, report = examine_arm(rig, FOLLOWER)
    assert status == 0
    assert found(report, "warning", "joint_2", "coil 92 °C; it switches itself off at 100 °C")


def test_a_leader_in_place_of_a_follower(rig):
    """Swapped cables."""
    status, report = examine_arm(rig, LEADER)
    assert status == 1
    (problem,) = found(report, "problem", "gripper (id 7)", "a teaching handle answers")
    assert f"--channel {LEADER}:yam:yam_teaching_handle" in problem["remedy"]
    _, report = examine_arm(rig, f"{LEADER}:yam:no_gripper")
    assert found(report, "problem", LEADER, "a teaching handle answers, which gripper profile no_gripper does not have")


def test_a_follower_in_place_of_a_leader(rig):
    status, report = examine_arm(rig, f"{FOLLOWER}:yam:yam_teaching_handle")
    assert status == 1
    assert found(report, "problem", f"{FOLLOWER} motor id 7", "the profile does not have")
    assert found(report, "problem", f"{FOLLOWER} teaching handle", "does not answer")


def test_another_arm_than_the_profile_says(rig):
    _, report = examine_arm(rig, f"{FOLLOWER}:big_yam")
    problems = found(report, "problem", "joint_1 (id 1)")
    assert len(problems) == 1 and "gear ratio is 40" in problems[0]["what"]


def test_an_ultra_of_the_other_revision(rig):
    """This rig's joint 4 is a DM4310."""
    _, report = examine_arm(rig, f"{FOLLOWER}:yam_ultra_2")
    (problem,) = [f for f in report["findings"] if "gear ratio" in f["what"]]
    assert "joint_4 (id 4)" in problem["where"] and "instead of 40 (DM4340)" in problem["what"]


def test_a_channel_that_the_rig_does_not_have(rig):
    status, report = examine_arm(rig, "nowhere")
    assert status == 1
    assert found(report, "problem", "nowhere", "nowhere")


@pytest.mark.parametrize(
    ("register", "wrong"), [(Register.PMAX, 6.0), (Register.TIMEOUT, 4000), (Register.MST_ID, 0x33)], ids=str
)
def test_what_a_session_would_refuse_is_repaired_by_the_remedy(rig, tmp_path, monkeypatch, register, wrong):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    rig.fault(FOLLOWER, "joint_4", "register", wrong, register=int(register))
    status, report = examine_arm(rig, FOLLOWER)
    assert status == 1
    (problem,) = found(report, "problem", "joint_4")
    with can.Bus(interface="yam_lockstep", channel=FOLLOWER, rig=rig.name) as bus:
        with pytest.raises(MotorError, match="joint_4"):
            motor_inspection.verify(MotorChain(bus, MOTORS, channel=FOLLOWER))
    program, *arguments = shlex.split(problem["remedy"].partition(" (")[0])
    assert program == "yam-motors" and repair([*arguments, "--yes", f"--rig={rig.name}"]) == 0
    with can.Bus(interface="yam_lockstep", channel=FOLLOWER, rig=rig.name) as bus:
        motor_inspection.verify(MotorChain(bus, MOTORS, channel=FOLLOWER))
