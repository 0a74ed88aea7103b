import pytest

from lerobot_robot_yam.damiao import motor_inspection
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.errors import ChannelInUseError, ConfigError, MotorError
from tests.support.desk_bus import DeskBus

SPECS = [
    MotorSpec("joint1", 1, "DM4340"),
    MotorSpec("joint2", 2, "DM4310"),
    MotorSpec("gripper", 7, "DM4310"),
]
IDS = [1, 2, 7]


@pytest.fixture
def bus():
    with DeskBus(SPECS) as desk:
        yield desk


@pytest.fixture
def chain(bus):
    return MotorChain(bus, SPECS, channel="desk")


def test_motors_that_match_pass_and_nothing_is_commanded(bus, chain):
    motor_inspection.verify(chain)
    assert {message.arbitration_id for message in bus.sent} == {0x7FF}
    assert {message.data[2] for message in bus.sent} == {0x33, 0xCC}


@pytest.mark.parametrize(
    ("register", "value"),
    [
        (Register.PMAX, 12.566),
        (Register.VMAX, 8.0),
        (Register.TMAX, 28.0),
        (Register.TIMEOUT, 0),
        (Register.MST_ID, 0),
        (Register.CTRL_MODE, 3),
        (Register.GR, 40.0),
    ],
)
def test_a_contradiction_names_motor_and_register(bus, chain, register, value):
    bus.registers[2][register] = value
    with pytest.raises(MotorError, match=rf"(?i)joint2 \(id 2, DM4310\): {register.name} is {value:g} instead of"):
        motor_inspection.verify(chain)


def test_all_contradictions_are_named_at_once(bus, chain):
    bus.registers[1][Register.TMAX] = 10.0
    bus.registers[7][Register.TIMEOUT] = 0
    with pytest.raises(MotorError, match=r"joint1.*TMAX.*gripper.*TIMEOUT"):
        motor_inspection.verify(chain)


def test_a_float32_register_equals_its_constant(bus, chain):
    bus.registers[1][Register.PMAX] = 12.500001
    motor_inspection.verify(chain)


def test_missing_motors_are_all_named_with_causes(bus, chain):
    bus.silent.update((1, 7))
    with pytest.raises(
        MotorError, match=r"2 of 3 motors: joint1 \(id 1\), gripper \(id 7\)\. Check its cable and plugs"
    ):
        motor_inspection.verify(chain)
    bus.silent.add(2)
    with pytest.raises(MotorError, match=r"3 of 3 motors: .*power.*cable.*bit-rate"):
        motor_inspection.verify(chain)


def test_a_motor_that_answers_elsewhere_is_hinted_at(bus, chain):
    bus.silent.add(2)
    bus.put(0x42, bytes(8))
    with pytest.raises(MotorError, match=r"0x42.*MST_ID"):
        motor_inspection.verify(chain)


def test_two_motors_with_one_id_are_refused(bus, chain):
    bus.doubled.add(2)
    with pytest.raises(MotorError, match=r"more than one answer from joint2 \(id 2\)"):
        motor_inspection.verify(chain)


@pytest.mark.parametrize("can_id", [1, 7, 0x102, 0x201, 0x301, 0x7FF, 0x17, 0])
def test_a_foreign_driver_is_heard(bus, can_id):
    bus.put(can_id, bytes(8))
    with pytest.raises(ChannelInUseError, match=f"can9.*0x{can_id:X}"):
        motor_inspection.listen(bus, 0.005, IDS, "can9")
    assert not bus.sent


def test_a_foreign_driver_is_heard_by_a_listener_that_did_not_run(bus):
    bus.put(0x123, bytes(8))
    bus.put(1, bytes(8))
    bus.stall_s = 0.02  # several times as long as it meant to listen
    with pytest.raises(ChannelInUseError, match="0x1 "):
        motor_inspection.listen(bus, 0.005, IDS, "can9")


@pytest.mark.parametrize("can_id", [3, 0x50F, 0x123])
def test_other_devices_may_talk(bus, can_id):
    bus.put(can_id, bytes(8))
    bus.put(1, bytes(8), is_error_frame=True)
    motor_inspection.listen(bus, 0.005, IDS, "can9")


def test_bandwidth_limit_is_the_documented_one():
    motor_inspection.check_bandwidth(7, False, 499)
    with pytest.raises(ConfigError, match="at most 500 Hz"):
        motor_inspection.check_bandwidth(7, False, 500)
    with pytest.raises(ConfigError, match="handle"):
        motor_inspection.check_bandwidth(7, True, 499)
    motor_inspection.check_bandwidth(7, True, 250)
