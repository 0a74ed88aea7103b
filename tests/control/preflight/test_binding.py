"""Which arm is on a channel: bound and compared; arms of the rig, and made-up ones with adapters."""

import json
import logging
from dataclasses import replace

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import arm_ids
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.preflight.binding import Binding, check_identity, contradictions
from lerobot_robot_yam.control.preflight.binding import bind as bind_arm
from lerobot_robot_yam.control.preflight.fingerprint import Adapter, Fingerprint, MotorPrint, read_fingerprint
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.rig.control import running_rig

YAM = load_arm("yam")


def bind(path, name, channel, found, force=False):
    return bind_arm(path, name, channel, found, YAM, force)


def look(rig, channel):
    with can.Bus(interface="yam_sim", channel=channel, rig=rig.name) as bus:
        return read_fingerprint(bus, channel, "yam_sim", arm_ids(YAM))


def swap_cables(rig, one, other):
    """What is read on one channel is read on the other from now on; serial numbers are all that differs."""
    serials = {channel: look(rig, channel).serials for channel in (one, other)}
    for channel, source in ((one, other), (other, one)):
        for can_id, serial in serials[source].items():
            rig.fault(channel, can_id, "register", serial, register=int(Register.SN))


def motor(serial, gear=40.0, software=5013):
    return MotorPrint(gear, 12.5, 10.0, 28.0, serial, 10, software, 0)


def follower(first_serial=100, adapter=None, software=5013):
    """Serials count up from the first, or are all 0."""
    serials = [first_serial + i if first_serial else 0 for i in range(1, 8)]
    return Fingerprint({i: motor(s, software=software) for i, s in enumerate(serials, 1)}, None, adapter)


def leader(first_serial):
    motors = follower(first_serial).motors
    return Fingerprint({i: m for i, m in motors.items() if i < 7}, (2, 4, 0), None)


def test_a_channel_without_power_says_so(tmp_path):
    empty = Fingerprint({}, None, None)
    with pytest.raises(MotorError, match="nothing answers on channel can0.*power"):
        check_identity(tmp_path / "left.json", empty, "can0", "left")
    with pytest.raises(MotorError, match="no whole arm"):
        bind(tmp_path / "left.json", "left", "can0", empty)
    partial = Fingerprint({i: motor(i) for i in (1, 2, 3, 5, 6)}, None, None)
    with pytest.raises(MotorError, match="id 1, 2, 3, 5, 6.*no whole arm"):
        bind(tmp_path / "left.json", "left", "can0", partial)
    assert not list(tmp_path.iterdir())


def test_two_arms_on_swapped_channels_are_refused_by_name(rig, tmp_path):
    paths = {side: tmp_path / f"{side}.json" for side in ("left", "right")}
    for side, path in paths.items():
        assert bind(path, f"{side}_lab", f"follower_{side}", look(rig, f"follower_{side}")) == []
    for side, path in paths.items():
        assert check_identity(path, look(rig, f"follower_{side}"), f"follower_{side}", side) == []
    swap_cables(rig, "follower_left", "follower_right")
    for side, other in (("left", "right"), ("right", "left")):
        message = (
            f"{side}: channel follower_{side} carries the arm bound as '{other}_lab', not '{side}_lab': "
            "cables or adapters are swapped .*7 of 7 motors have another serial number"
        )
        with pytest.raises(MotorError, match=message):
            check_identity(paths[side], look(rig, f"follower_{side}"), f"follower_{side}", side)


def test_a_leader_on_a_followers_channel_is_named_even_with_equal_serial_numbers(tmp_path):
    with running_rig(serials="same") as rig:
        bind(tmp_path / "f.json", "follower", "follower_left", look(rig, "follower_left"))
        bind(tmp_path / "l.json", "leader", "leader_left", look(rig, "leader_left"))
        for path, channel, expected, carried in (
            ("f.json", "leader_left", "follower", "leader"),
            ("l.json", "follower_left", "leader", "follower"),
        ):
            with pytest.raises(MotorError, match=f"carries the arm bound as '{carried}', not '{expected}'"):
                check_identity(tmp_path / path, look(rig, channel), channel, "left")


def test_identical_arms_are_said_to_be_so(tmp_path, caplog):
    with running_rig(serials="same") as rig:
        assert bind(tmp_path / "left.json", "left_lab", "follower_left", look(rig, "follower_left")) == []
        notes = bind(tmp_path / "right.json", "right_lab", "follower_right", look(rig, "follower_right"))
        assert len(notes) == 1 and "cannot be told apart from the one bound as 'left_lab'" in notes[0]
        assert "yam-identify --wiggle" in notes[0]
        found = look(rig, "follower_right")
    (warning,) = check_identity(tmp_path / "right.json", found, "follower_right", "right")
    assert "cannot be told apart from 'left_lab'" in warning and "--wiggle" in warning
    assert warning in caplog.text


@pytest.mark.parametrize("first", [0, None])
def test_serial_numbers_that_say_nothing_are_said_to_be_so(tmp_path, first):
    found = follower(0)
    if first is None:
        found = replace(found, motors={i: replace(m, serial=None) for i, m in found.motors.items()})
    (note,) = bind(tmp_path / "left.json", "left", "can0", found)
    assert "no serial numbers of their own" in note and "--wiggle" in note


def test_a_moved_adapter_is_a_warning_when_the_serial_numbers_agree(tmp_path, caplog):
    before, after = Adapter("A1", "1-2:1.0"), Adapter("B7", "1-4:1.0")
    bind(tmp_path / "left.json", "left_lab", "can0", follower(100, before))
    bind(tmp_path / "right.json", "right_lab", "can1", follower(200, after))
    (warning,) = check_identity(tmp_path / "left.json", follower(100, after), "can0", "left")
    assert "fits 'left_lab', but another adapter or port" in warning and "1-2:1.0" in warning and "1-4:1.0" in warning


def test_swapped_adapters_of_identical_arms_are_named(tmp_path):
    """Equal serial numbers: the adapter is all there is to go by."""
    one, two = Adapter("A1", "1-2:1.0"), Adapter("A1", "1-4:1.0")  # cheap adapters share one serial
    bind(tmp_path / "left.json", "left_lab", "can0", follower(0, one))
    notes = bind(tmp_path / "right.json", "right_lab", "can1", follower(0, two))
    assert any("only the adapter tells this arm from 'left_lab'" in note for note in notes)
    with pytest.raises(MotorError, match="carries the arm bound as 'right_lab', not 'left_lab': the adapters' names"):
        check_identity(tmp_path / "left.json", follower(0, two), "can0", "left")
    assert check_identity(tmp_path / "left.json", follower(0, one), "can0", "left") == []


def test_it_says_whether_cables_or_adapters_are_swapped(tmp_path):
    one, two = Adapter("A1", "1-2:1.0"), Adapter("B7", "1-4:1.0")
    bind(tmp_path / "left.json", "left_lab", "can0", follower(100, one))
    bind(tmp_path / "right.json", "right_lab", "can1", follower(200, two))
    for adapter, swapped in ((one, "the CAN cables"), (two, "the adapters' names")):
        with pytest.raises(MotorError, match=f"'right_lab', not 'left_lab': {swapped} are swapped"):
            check_identity(tmp_path / "left.json", follower(200, adapter), "can0", "left")


def test_what_changed_on_one_arm_is_told_from_another_arm(tmp_path):
    path = tmp_path / "left.json"
    bind(path, "left_lab", "can0", follower(100))
    bind(tmp_path / "right.json", "right_lab", "can1", follower(200))
    (warning,) = check_identity(path, follower(100, software=5014), "can0", "left")
    assert "another firmware (id 1, 2, 3, 4, 5, 6, 7)" in warning
    (warning,) = check_identity(path, follower(100), "can5", "left")
    assert "another channel name (bound: can0; now: can5)" in warning
    assert warning.endswith(f": yam-identify --channel can5 --name left_lab --bind {path}")
    (warning,) = check_identity(path, follower(100), "can5", "left", "--channel can5 --rig desk")
    assert warning.endswith(f": yam-identify --channel can5 --rig desk --name left_lab --bind {path}")
    silent = follower(100)
    del silent.motors[7]
    (warning,) = check_identity(path, silent, "can0", "left")
    assert "motors do not answer (id 7)" in warning
    exchanged = follower(100)
    exchanged.motors[4] = motor(999)
    with pytest.raises(MotorError, match=r"1 of 7 motors .* \(id 4\).*motors were exchanged.*--force"):
        check_identity(path, exchanged, "can0", "left")
    with pytest.raises(MotorError, match="nor any other arm bound in .*Look for swapped cables"):
        check_identity(path, follower(300), "can0", "left")


def test_contradictions_name_what_one_arm_cannot_become():
    assert contradictions(follower(100), follower(100)) == []
    assert "another type (id 2)" in contradictions(follower(100), with_gear(follower(100), 2, 10.0))[0]
    assert contradictions(leader(100), follower(100)) == ["motors that were not there (id 7)"]
    assert contradictions(follower(100), leader(100)) == ["a teaching handle that was not there"]


def with_gear(found, can_id, gear):
    return replace(found, motors=found.motors | {can_id: replace(found.motors[can_id], gear_ratio=gear)})


def test_a_binding_of_another_arm_is_not_overwritten_unasked(tmp_path):
    path = tmp_path / "left.json"
    bind(path, "left_lab", "can0", follower(100))
    before = path.read_bytes()
    with pytest.raises(MotorError, match="already binds 'left_lab', and the arm on channel can1 is another one.*force"):
        bind(path, "right_lab", "can1", follower(200))
    assert path.read_bytes() == before
    bind(path, "left_lab", "can4", follower(100, software=5014))  # the same arm: refreshed
    assert Binding.load(path).channel == "can4"
    bind(path, "right_lab", "can1", follower(200), force=True)
    assert Binding.load(path) == Binding("right_lab", "can1", follower(200))
    assert [p.name for p in tmp_path.iterdir()] == ["left.json"]


def test_a_binding_that_is_not_there_is_refused_with_the_command_that_makes_it(tmp_path):
    path = tmp_path / "left.json"
    with pytest.raises(ConfigError, match=f"left: .* {path}; .*`identity_path`.*yam-identify --channel can0 --bind"):
        check_identity(path, follower(), "can0", "left")


def test_other_files_beside_a_binding_do_not_matter(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    bind(tmp_path / "left.json", "left_lab", "can0", follower(100))
    (tmp_path / "gripper.json").write_text('{"version": 1, "closed_rad": 3.2}')
    (tmp_path / "half.json").write_text('{"kind": "yam arm bi')
    (tmp_path / "folder.json").mkdir()
    assert check_identity(tmp_path / "left.json", follower(100), "can0", "left") == []
    assert not caplog.records


adapters = st.none() | st.builds(Adapter, serial=st.none() | st.text(), port=st.text())
prints = st.builds(
    Fingerprint,
    motors=st.dictionaries(
        st.integers(1, 7), st.builds(motor, st.none() | st.integers(0, 2**32 - 1), st.none() | st.floats(0, 99))
    ),
    handle_firmware=st.none() | st.tuples(*[st.integers(0, 255)] * 3),
    adapter=adapters,
)
EXAMPLES = settings(max_examples=100, deadline=None)


@EXAMPLES
@given(found=prints, name=st.text(st.characters(exclude_categories=["Cs"])))
def test_a_binding_survives_the_file(tmp_path_factory, found, name):
    path = tmp_path_factory.mktemp("identity") / "x.json"
    Binding(name, "can0", found).save(path)
    assert Binding.load(path) == Binding(name, "can0", found)


BASE = {"kind": "yam arm binding", "version": 1, "name": "left", "channel": "can0"}
damage = st.one_of(
    st.just(b"[" * 100_000),
    st.binary(max_size=60),
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    ).map(lambda value: json.dumps({**BASE, "fingerprint": value}).encode()),
    st.sampled_from(sorted(BASE)).map(lambda key: json.dumps({**BASE, key: None, "fingerprint": {}}).encode()),
    st.just(json.dumps({**BASE, "fingerprint": follower().to_dict() | {"motors": {"1": {}}}}).encode()),
    st.just(json.dumps({**BASE, "fingerprint": follower().to_dict() | {"motors": {"one": vars(motor(1))}}}).encode()),
    st.just(
        json.dumps({**BASE, "fingerprint": follower().to_dict() | {"adapter": {"serial": 1, "port": []}}}).encode()
    ),
)


@EXAMPLES
@given(content=damage)
def test_a_damaged_binding_is_an_error_that_says_what_to_do(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("identity") / "left.json"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="left.json is not a readable arm binding.*bind the arm again"):
        check_identity(path, follower(), "can0", "left")


@pytest.mark.parametrize(
    ("fields", "options"),
    [
        ({}, "--channel can0"),
        ({"interface": "slcan"}, "--channel can0 --interface slcan"),
        ({"interface": "yam_sim"}, "--channel can0 --interface yam_sim"),
        ({"interface": "yam_sim", "can_options": {"rig": "auto-1"}}, "--channel can0 --interface yam_sim"),
        ({"interface": "yam_sim", "can_options": {"rig": "a desk"}}, "--channel can0 --rig 'a desk'"),
    ],
)
def test_commands_that_messages_name_reach_the_channel(fields, options):
    assert ArmConfig(channel="can0", **fields).on_command_line == options


def test_a_binding_that_cannot_be_read_or_written_is_an_error_and_leaves_nothing(tmp_path):
    path = tmp_path / "left.json"
    path.mkdir()
    with pytest.raises(ConfigError, match="cannot read the arm binding"):
        bind(path, "left", "can0", follower())
    with pytest.raises(ConfigError, match="cannot write the arm binding"):
        bind(path, "left", "can0", follower(), force=True)
    assert list(tmp_path.iterdir()) == [path]
