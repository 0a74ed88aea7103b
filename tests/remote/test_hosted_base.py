"""The base of a host over the link, in lock-step: driving, silence, old and wrong commands, requests, stops."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_mobile import YamBaseRemoteConfig
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, LinkError, MotorError
from lerobot_robot_yam.mobile.base_target import Frame
from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.remote import link_messages as wire
from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.hosted_device import HostedDevice
from lerobot_robot_yam.remote.hosted_group import Phase
from lerobot_robot_yam.remote.mirrored_part import times_in
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.base_records import BASE_COMMAND_DTYPE, BASE_STATE_DTYPE, BaseRequest
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, PUBLISHED, STATE_DTYPE
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.yam_mobile import YamBaseRemote
from tests.mobile.rails import Rail
from tests.support.hosted import ServedArms, configs_of
from tests.support.link_in_step import LinkInStep
from tests.support.waiting import wait

BRAKED_S = 0.25 + 0.4 / 0.25 + 0.1  # time-out and planned braking from 0.4 m/s


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("mobile")) as rig:
        yield rig


@pytest.fixture
def served(rig):
    with ServedArms(rig, "base") as served:
        yield served


@pytest.fixture
def session(served):
    device = HostedDevice(Host(served.address), "robot", ("base_",))
    session = ArmSession(configs_of(device), LinkInStep.on(served, device))
    session.start()
    yield session
    session.stop()


@pytest.fixture
def base(session):
    return session.base("base")


def drive(session, velocity, seconds, frame=Frame.LOCAL):
    for _ in range(round(seconds / 0.05)):
        session.base("base").write_velocity(velocity, frame)
        session.clock.sleep(0.05)


def truth(rig):
    return np.array(rig.state()["base"]["pose"])


def there(served):
    """The host's own client of the base."""
    return served.groups[0]._session.base("base")


def test_it_drives_and_brakes_when_its_client_is_silent(rig, served, session, base):
    drive(session, [0.4, 0.0, 0.0], 4.0)
    state = base.observe()
    assert state.mode is Mode.TRACK and state.body_twist == pytest.approx([0.4, 0.0, 0.0], abs=0.02)
    assert state.pose == pytest.approx(truth(rig), abs=0.03)
    world = served.groups[0]._session.clock
    world.sleep(BRAKED_S)  # nothing goes over the link
    assert there(served).observe().mode is Mode.HOLD
    assert np.abs(there(served).observe().twist).max() < 0.01


@pytest.mark.long
def test_it_goes_to_poses_of_its_odometry(rig, session, base):
    target = base.write_pose([0.3, 0.2, 0.5], Frame.LOCAL)
    for _ in range(120):
        session.clock.sleep(0.05)
        base.write_pose(target, Frame.GLOBAL)
    assert truth(rig) == pytest.approx(target, abs=0.02)


def test_requests_are_carried_out_and_answered(session, base):
    drive(session, [0.4, 0.0, 0.2], 2.0)
    assert np.abs(base.observe().pose).max() > 0.2
    base.hold()
    session.clock.sleep(BRAKED_S)
    base.reset_odometry()
    assert np.abs(base.observe().pose).max() < 0.01
    base.write_pose([0.5, 0.0, 0.0])
    session.clock.sleep(0.1)
    with pytest.raises(LifeCycleError, match="drives to a pose"):
        base.reset_odometry()


def test_an_emergency_stop_brakes_it(session, base):
    drive(session, [0.4, 0.0, 0.0], 2.0)
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        session.clock.sleep(1.0)
        state = base.observe()
        assert state.mode is Mode.STOPPED and np.abs(state.twist).max() < 0.01
        assert (base.write_velocity([0.4, 0.0, 0.0]) == 0.0).all()
    finally:
        stop.release()
    session.clock.sleep(0.1)
    assert base.observe().mode is Mode.HOLD


def test_it_brakes_and_is_off_when_its_host_lets_go(served, session, base):
    drive(session, [0.4, 0.0, 0.0], 2.0)
    (group,) = served.groups
    group.land("a test")
    wait(lambda: group.phase is Phase.FREE)
    session._runner._link._take_echo(wire.Echo(SYSTEM.now(), SYSTEM.now(), SYSTEM.now(), False))
    with pytest.raises(MotorError, match="has let go"):
        base.write_velocity([0.4, 0.0, 0.0])


def command(served, **fields):
    """A command of a client, with the present time of the host."""
    record = np.zeros((), BASE_COMMAND_DTYPE)
    now = served.groups[0]._session.clock.now()
    record["target_stamp_s"] = record["request_stamp_s"] = now
    for name, value in fields.items():
        record[name] = value + now if name.endswith("stamp_s") else value
    return record.tobytes()


@pytest.mark.parametrize(
    "fields",
    [
        {"target_stamp_s": -0.3},
        {"target_stamp_s": 0.2},
        {"target_stamp_s": np.nan},
        {"values": [np.nan, 0.0, 0.0]},
        {"values": [np.inf, 0.0, 0.0]},
        {"frame": 7},
        {"pose": 1},
        {"pose": 1, "frame": 1, "values": [1e6, 0.0, 0.0]},
        {"target_sequence": 0, "request_sequence": 99, "request": 77},
        {"target_sequence": 0, "request_sequence": 99, "request": BaseRequest.LAND, "request_stamp_s": -1.2},
    ],
    ids=str,
)
def test_a_command_that_is_old_or_wrong_moves_nothing(served, session, fields):
    given = {"values": [0.4, 0.0, 0.0], "target_sequence": 99, **fields}
    (part,) = served.groups[0].parts
    assert not part.take(command(served, **given))
    served.groups[0]._session.clock.sleep(0.2)
    assert there(served).observe().mode is Mode.HOLD


def test_a_target_counts_from_when_it_was_given(served, session):
    """The base brakes 0.25 s after its client has given the target, not after the host has it."""
    (part,) = served.groups[0].parts
    assert part.take(command(served, values=[0.4, 0.0, 0.0], target_sequence=99, target_stamp_s=-0.2))
    clock = served.groups[0]._session.clock
    clock.sleep(0.04)
    assert there(served).mode() is Mode.TRACK
    clock.sleep(0.02)
    assert there(served).mode() is Mode.HOLD


def test_a_command_for_an_arm_is_refused(served, session):
    (part,) = served.groups[0].parts
    with pytest.raises(LinkError, match="wrong size"):
        part.take(np.zeros((), COMMAND_DTYPE).tobytes())


def test_another_type_is_named(served):
    with pytest.raises(ConfigError, match="is a yam_base; its type here is yam_base_remote"):
        HostedDevice(Host(served.address), "robot", ("",))


def test_its_rail_goes_over_the_link(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    rail = Rail(tmp_path, 0.3)
    config = RailConfig(io="sim", calibration_path=f"~/{rail.path.name}", stroke_m=rail.stroke_m)
    with contextlib.closing(rail.rig), ServedArms(rail.rig, "base", rail=config) as served:
        device = HostedDevice(Host(served.address), "robot", ("base_",))
        (own,) = configs_of(device)
        assert device.calibrated and own.rail.calibration_path is None and own.rail.stroke_m == rail.stroke_m
        session = ArmSession([own], LinkInStep.on(served, device))
        session.start()
        try:
            base = session.base("base")
            for _ in range(60):
                base.write_rail_height(0.5)
                session.clock.sleep(0.05)
            assert base.rail_state().height_m == pytest.approx(rail.height_m, abs=0.01)
            assert rail.height_m == pytest.approx(0.5, abs=0.01)
            base.write_rail_velocity(-0.2)
            session.clock.sleep(1.5)  # it brakes once the target is 0.25 s old
            assert rail.height_m == pytest.approx(0.5 - 0.2 * 0.25, abs=0.05)
            assert abs(base.rail_state().velocity_m_s) < 0.005
        finally:
            session.stop()


def test_a_rail_is_homed_on_its_own_computer(tmp_path):
    rail = Rail(tmp_path, 0.3, known=False)
    config = RailConfig(io="sim", calibration_path=str(rail.path), stroke_m=rail.stroke_m)
    with contextlib.closing(rail.rig), ServedArms(rail.rig, "base", rail=config) as served:
        options = YamBaseRemoteConfig(host=str(served.address), calibration_dir=tmp_path)
        options.runs = lambda: LinkInStep.on(served, options.hosted)
        robot = YamBaseRemote(options)
        assert not robot.is_calibrated
        with pytest.raises(LifeCycleError, match="not homed.* on the robot's own computer"):
            robot.connect()
        assert not robot.is_connected
        robot.connect(calibrate=False)
        try:
            with pytest.raises(ConfigError, match="on its own computer"):
                robot.calibrate()
            assert rail.height_m == pytest.approx(0.3, abs=0.002)
        finally:
            robot.disconnect()


def test_all_times_of_the_records_are_known():
    """They are converted between the clocks of host and client by their names."""
    own = {"stamp_s", "asked_s", "motor_stamp_s"}
    assert set(times_in(STATE_DTYPE)) == {*own, "handle_stamp_s", "action_stamp_s"}
    assert set(times_in(COMMAND_DTYPE)) == {"target_stamp_s", "request_stamp_s"}
    assert set(times_in(BASE_STATE_DTYPE)) == own
    assert set(times_in(BASE_COMMAND_DTYPE)) == {"target_stamp_s", "rail_stamp_s", "request_stamp_s"}
    assert PUBLISHED[0] == BASE_STATE_DTYPE.fields["stamp_s"][1]
