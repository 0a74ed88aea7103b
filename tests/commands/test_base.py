"""yam-base on the rig: a limp base that is pushed shows what is wrong with it; a measured drive finds its sizes."""

import contextlib
import math

import numpy as np
import pytest
import yaml

from lerobot_robot_yam.commands.base import main
from lerobot_robot_yam.commands.lib.arm_command import own_bus
from lerobot_robot_yam.commands.lib.base_tune import BaseSizes, measure_base, write_sizes
from lerobot_robot_yam.commands.lib.roll_check import RolledBase, roll_check
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, MotorError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.base_profile import CASTERS, BaseProfile
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from tests.support.base_rig import arguments, motors, scene

ID = int(Register.ESC_ID)
PERIOD_S = 0.04
WAY = {"ahead": 0.5, "Turn": 1.3}  # m, rad
PUSH_N = {"ahead": 12.0, "Turn": 8.0}  # at each caster; a person does not jerk the base
MOST_SECONDS = 8.0


@pytest.fixture
def made(tmp_path):
    """Makes a rig in lock-step whose base deviates so."""
    with contextlib.ExitStack() as stack:
        yield lambda **row: stack.enter_context(contextlib.closing(LockstepRig(scene(tmp_path, **row))))


def config(rig, **fields):
    return BaseConfig(channel="base", interface="yam_lockstep", can_options={"rig": rig.name}, **fields)


class Person:
    """Pushes at the casters until the base has moved as the text says, and stops it."""

    def __init__(self, rig):
        self._rig = rig

    def begin(self, text):
        self._kind = next(kind for kind in WAY if kind in text)
        self._start = self._pose = self._read()

    def _read(self):
        return np.array(self._rig.state()["base"]["pose"])

    def push(self):
        """Push for a moment; return whether the base has arrived, and stands."""
        pose, spot = self._read(), self._kind == "Turn"
        moved, step = pose - self._start, pose - self._pose
        self._pose = pose
        way, speed = (abs(moved[2]), 0.0) if spot else (np.hypot(*moved[:2]), moved[:2] @ step[:2])
        there = way > WAY[self._kind]
        if there and (spot or speed <= 0.0):
            return True
        profile, force = BaseProfile(), PUSH_N[self._kind] * (-1.0 if there else 1.0)
        for name, x, y in zip(CASTERS, profile.h_x_m, profile.h_y_m, strict=True):
            along = np.array([-y, x]) / math.hypot(x, y) if spot else np.array([1.0, 0.0])
            s, c = math.sin(pose[2]), math.cos(pose[2])
            world = force * np.array([c * along[0] - s * along[1], s * along[0] + c * along[1], 0.0])
            self._rig.push("base", f"{name}_fork", world.tolist(), 1.5 * PERIOD_S)
        return False

    def does(self, text, sample):
        self.begin(text)
        for _ in range(round(MOST_SECONDS / PERIOD_S)):
            if self.push():
                return
            for _ in range(2):
                self._rig.sleep(PERIOD_S / 2)
                sample()
        raise AssertionError(f"not there: {self._read()}")


def check(rig):
    with own_bus(config(rig)) as bus:
        shown, problems = roll_check(RolledBase(config(rig), bus), Person(rig).does)
    assert not any(motor["enabled"] for motor in motors(rig).values())
    return shown, problems


def swap(rig, *pairs):
    """Give two motors each other's ids, and what they answer as."""
    ids = {motor["id"]: name for name, motor in motors(rig).items()}
    names = {first: ids[second] for pair in pairs for first, second in (pair, pair[::-1])}
    for new, name in names.items():
        rig.fault("base", name, "register", new, register=ID)
        rig.fault("base", name, "register", new + 16, register=int(Register.MST_ID))


def test_a_base_that_rolls_true_and_nothing_is_energised(made):
    shown, problems = check(made())
    assert not problems and len(shown.splitlines()) == 9


def test_a_steering_zero_off_by_a_quarter_turn_is_named(made):
    shown, problems = check(made(steer_zero_rad=[0.0, math.pi / 2, 0.0, 0.2]))
    first, second = problems
    assert -95 < float(first.split("at ")[1].split("°")[0]) < -85 and first.startswith("front_left: it trails")
    assert "yam-zero --channel base" in first and "--joint front_left_steer" in first
    assert second.startswith("rear_right: it trails at -1")


def test_swapped_steering_and_drive_are_named(made):
    rig = made()
    swap(rig, (3, 4))
    _, (problem,) = check(rig)
    assert problem.startswith("front_left: id 3 turns as a wheel does and id 4 as a caster: their ids are swapped")


@pytest.mark.parametrize(
    "pairs, what",
    [
        ([(3, 5), (4, 6)], "the ids of the casters front_left and front_right"),
        pytest.param([(2, 6)], "the ids of the wheels rear_left and front_right", marks=pytest.mark.long),
        pytest.param([(1, 7)], "the ids of the steering motors rear_left and rear_right", marks=pytest.mark.long),
    ],
)
def test_motors_exchanged_between_casters_show_in_the_turn(made, pairs, what):
    rig = made()
    swap(rig, *pairs)
    _, (problem,) = check(rig)
    assert problem.startswith(what)


def test_all_casters_that_trail_backwards_were_pushed_backwards(made):
    with pytest.raises(MotorError, match="was it pushed backwards"):
        check(made(steer_zero_rad=[math.pi - 0.05] * 4))


def test_not_pushed_or_energised_is_an_error(made):
    rig = made()
    with own_bus(config(rig)) as bus, pytest.raises(MotorError, match=r"its wheels rolled by 0.00 m only"):
        roll_check(RolledBase(config(rig), bus), lambda text, sample: sample())


def test_the_command_asks_at_a_terminal(made, type_in, capsys):
    rig = made()
    type_in(b"\n")
    assert main(["check", *arguments(rig, arm=())]) == 1
    said = capsys.readouterr().err
    assert "Push the base straight ahead" in said and "its wheels rolled by 0.00 m only" in said


def test_a_wheel_that_turns_the_other_way_is_named(made):
    rig = made()
    rows, sign = [], np.array([1, 1, 1, -1, 1, 1, 1, 1])
    with own_bus(config(rig)) as bus:
        base = RolledBase(config(rig), bus)

        def turned(text, sample):
            Person(rig).does(text, sample)
            rows[:] = base.rows
            base.rows = [row * sign for row in rows]

        _, (problem,) = roll_check(base, turned)
    assert problem.startswith("front_left_drive turns the other way")


def test_a_measured_drive_finds_the_sizes(made):
    rig = made(wheel_radius_m=0.0515, track_factor=1.04)
    poses = [np.array(rig.state()["base"]["pose"])]

    def measured(question, counted):
        poses.append(np.array(rig.state()["base"]["pose"]))
        way = poses[-1] - poses[-2]
        if " m?" in question:
            return float(np.hypot(*way[:2]))
        return math.degrees(math.remainder(way[2] - math.radians(counted), math.tau)) + counted

    sizes = measure_base(config(rig), 1.0, measured, "lockstep")
    assert sizes.wheel_radius_m == pytest.approx(0.0515, rel=0.005)
    assert sizes.track_factor == pytest.approx(1.04, rel=0.01)
    assert not any(motor["enabled"] for motor in motors(rig).values())


def test_a_base_that_was_stopped_in_its_measured_drive_stays_when_the_stop_is_released(made, monkeypatch):
    rig, stop, written = made(), EmergencyStop(), []
    drive, close = YamBase.set_target_velocity, YamBase.close

    def driven(base, velocity):
        written.append(velocity)
        if len(written) == 20:
            stop.latch("a test")
        assert len(written) < 40, "it waits for the release"
        return drive(base, velocity)

    def closed(base):
        stop.release()  # a base that is stopped does not leave
        close(base)

    monkeypatch.setattr(YamBase, "set_target_velocity", driven)
    monkeypatch.setattr(YamBase, "close", closed)
    with pytest.raises(LifeCycleError, match="emergency stop was latched; nothing is kept"):
        measure_base(config(rig), 0.5, lambda question, counted: pytest.fail("it went on"), "lockstep")
    assert len(written) == 20 and not any(motor["enabled"] for motor in motors(rig).values())


def test_a_way_that_cannot_be_is_refused(made):
    rig = made()
    with pytest.raises(ConfigError, match="the measured way is 2.00 times the counted one"):
        measure_base(config(rig), 0.3, lambda question, counted: 2.0 * counted, "lockstep")
    assert not any(motor["enabled"] for motor in motors(rig).values())


@pytest.mark.parametrize("kind", ["yam_base", "yam_mobile"])
def test_sizes_are_written_into_a_rigs_file(tmp_path, kind):
    base = {"channel": "can_base", "wheel_radius_m": 0.05}
    robot = {"type": kind, **(base if kind == "yam_base" else {"base_config": base})}
    path = tmp_path / "rig.yaml"
    path.write_text("# a rig\n#\n\n" + yaml.safe_dump({"robot": robot, "teleop": {"type": "yam_gamepad"}}))
    write_sizes(path, BaseSizes(0.051, 1.02))
    held = yaml.safe_load(path.read_text())
    found = held["robot"].get("base_config", held["robot"])
    assert (found["wheel_radius_m"], found["track_factor"], held["teleop"]["type"]) == (0.051, 1.02, "yam_gamepad")
    assert path.read_text().startswith("# a rig\n#\n\n")
    path.write_text("robot: {type: yam_follower, id: lab}\n")
    with pytest.raises(ConfigError, match="has no robot with a base"):
        write_sizes(path, BaseSizes(0.051, 1.02))
