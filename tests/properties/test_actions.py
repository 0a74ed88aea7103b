"""Any action is refused by name, or comes back within the limits; and the arm never jumps."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import strategies as st

from lerobot_robot_yam.arm.validation import finite_floats, finite_vector
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig, YamFollowerConfig
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.target_limits import limit_target, validate_action
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.yam_follower import BiYamFollower, YamFollower
from tests.support.cases import SPECIAL, finite, for_all, junk, numbers

SINGLE = [*(f"joint_{n}.pos" for n in range(1, 7)), "gripper.pos"]
FREE = dict(zip(SINGLE, [0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.5], strict=True))  # an arm in the air
FREE_DEGREES = {key: value if key == "gripper.pos" else math.degrees(value) for key, value in FREE.items()}
FREE_PAIR = {f"{side}_{key}": value for side in ("left", "right") for key, value in FREE.items()}
STOPS_RAD = [3.25, -3.3]
TICK_S = 0.004

pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value", "ignore:Converting a tensor")


def arrays():
    """Arrays and tensors of any shape with up to two axes, of numbers and of what is none."""
    shapes = st.sampled_from([(), (1,), (2,), (7,), (1, 1), (0,), (6, 1)])
    kinds = st.sampled_from(["f8", "f4", "i2", "u1", "?", "c8", "U3", "O", "M8[s]"])

    def array(shape, kind, value):
        return np.full(shape, {"U": "1", "O": None, "M": 0}.get(kind[0], value)).astype(kind)

    made = st.builds(array, shapes, kinds, st.sampled_from([0.0, 1.0]) | st.floats(-100, 100))
    tensors = st.builds(
        lambda shape, value, kind, grad: torch.full(shape, value, dtype=kind, requires_grad=grad),
        shapes,
        st.floats(-1e30, 1e30) | st.sampled_from([math.nan, math.inf]),
        st.sampled_from([torch.float32, torch.float64, torch.bfloat16]),
        st.booleans(),
    )
    whole = st.builds(
        lambda shape, kind: torch.ones(shape, dtype=kind),
        shapes,
        st.sampled_from([torch.int8, torch.bool, torch.complex64]),
    )
    return made | tensors | whole | st.sampled_from([torch.empty((), device="meta")])


def values():
    """What may stand for one coordinate."""
    exotic = st.sampled_from([Decimal("0.5"), Decimal("NaN"), Decimal("1e999"), Fraction(1, 3), 1e-310, [], [[0.1]]])
    return st.one_of(st.floats(-3.5, 3.5), finite(), st.sampled_from(SPECIAL), numbers(), junk(), arrays(), exotic)


@st.composite
def actions(draw, free):
    """A complete action near the pose `free` with some values and keys spoilt, or something else altogether."""
    keys = list(free)
    if draw(st.integers(0, 19)) == 0:
        return draw(junk() | st.lists(st.floats(), max_size=7) | st.just(torch.zeros(7)))
    action = {key: value + draw(st.floats(-0.1, 0.1)) for key, value in free.items()}
    action |= draw(st.dictionaries(st.sampled_from(keys), values(), max_size=2))
    if draw(st.integers(0, 9)) == 0:
        del action[draw(st.sampled_from(keys))]
    if draw(st.integers(0, 9)) == 0:
        action[draw(st.text(max_size=5) | st.sampled_from([None, 3, ("a",), "joint_1.vel"]))] = draw(values())
    return action


@for_all(action=actions(FREE))
def test_an_action_is_a_finite_vector_or_refused(action):
    try:
        vector = validate_action("arm", action, SINGLE)
    except ActionError as error:
        assert "arm" in str(error)
        return
    assert vector.shape == (7,) and vector.dtype == np.float64 and np.isfinite(vector).all()
    assert set(action) == set(SINGLE)
    for key, number in zip(SINGLE, vector.tolist(), strict=True):
        assert not isinstance(action[key], str | bytes | bool | complex)
        assert number == float(action[key])


@for_all(
    value=st.lists(st.floats(-4, 4), min_size=6, max_size=6) | st.lists(values(), max_size=8) | arrays() | junk(),
    n=st.sampled_from([1, 6, 7]),
)
def test_a_vector_is_finite_and_private_or_refused(value, n):
    try:
        vector = finite_vector("arm", "q", value, n)
    except ActionError as error:
        assert "arm" in str(error) and "q" in str(error)
        with pytest.raises(ActionError):
            finite_floats("arm", "q", value, n)
        return
    assert finite_floats("arm", "q", value, n) == vector.tolist()
    assert vector.shape == (n,) and vector.dtype == np.float64 and np.isfinite(vector).all()
    assert not isinstance(value, str | bytes) and not any(isinstance(item, str | bytes) for item in value)
    if isinstance(value, np.ndarray):
        assert not np.shares_memory(value, vector)


@for_all(
    rows=st.lists(st.tuples(finite(), st.floats(-4, 4), st.floats(-4, 4), st.floats(0, 7)), min_size=1, max_size=7),
    relative=st.none() | st.floats(0, 10) | st.just(1e-310),
)
def test_a_limited_target_is_within_the_limits(rows, relative):
    target, measured, lower, width = (list(column) for column in zip(*rows, strict=True))
    upper = [low + w for low, w in zip(lower, width, strict=True)]
    limited_target, limited = limit_target(target, measured, lower, upper, relative)
    for got, wanted, here, low, high in zip(limited_target, target, measured, lower, upper, strict=True):
        assert low <= got <= high
        inside = min(max(wanted, low), high)
        if relative is None:
            assert got == inside
        else:
            near = min(max(here, low), high)  # where the arm is, as far as the limits admit it
            assert abs(got - near) <= relative + 1e-9
            assert min(inside, near) - 1e-9 <= got <= max(inside, near) + 1e-9
    if limited is Limited.NOTHING:
        assert all(abs(a - b) <= 0.011 for a, b in zip(limited_target, target, strict=True))


# connected, in lock-step


def lead(robot, action, seconds=2.0):
    """Lead the robot somewhere and let it come to rest."""
    clock = robot._arms.clock
    deadline = clock.now() + seconds
    while clock.now() < deadline:
        robot.send_action(action)
        clock.sleep(0.02)


class Watcher:
    """Set-points of all arms, and how far they may have moved since they were last looked at."""

    def __init__(self, robot):
        self._clock = robot._arms.clock
        self._sides = [(robot._arms[side], side.hardware) for side in robot._arms.sides]
        self._seen = [None] * len(self._sides)
        self.checked = 0

    def check(self):
        for index, (port, hardware) in enumerate(self._sides):
            state, now = port.observe(), self._clock.now()
            assert np.isfinite(state.q).all() and np.isfinite(state.setpoint_q).all()
            setpoint = np.append(state.setpoint_q, [] if state.gripper is None else [state.gripper_setpoint])
            before = self._seen[index]
            if before is not None:
                # From when the older state was measured to now: it is published later, the newer one before.
                elapsed = now - before[1] + TICK_S
                fits = np.abs(setpoint - before[0]) <= hardware.speed_limit * elapsed + 1e-9
                if state.gripper is not None and not fits[-1]:
                    # What it has pressed on is gone: its set-point starts again, but only from where the fingers are.
                    fits[-1] = abs(setpoint[-1] - state.gripper) < abs(before[0][-1] - state.gripper)
                assert np.all(fits), f"set-point {before[0]} to {setpoint} within {elapsed * 1e3:.1f} ms"
                self.checked += 1
            self._seen[index] = setpoint, state.stamp_s


def check_action(robot, watcher, action):
    """Send one action; whatever comes of it must be documented."""
    scale = robot._arms.scale
    lower = np.concatenate([side.hardware.lower for side in robot._arms.sides]) * scale
    upper = np.concatenate([side.hardware.upper for side in robot._arms.sides]) * scale
    watcher.check()
    try:
        sent = robot.send_action(action)
    except ActionError as error:
        assert robot.name in str(error)
    else:
        assert list(sent) == list(robot.action_features)
        assert all(type(value) is float and math.isfinite(value) for value in sent.values())
        vector = np.array(list(sent.values()))
        assert np.all((vector >= lower - 1e-9) & (vector <= upper + 1e-9))
    robot._arms.clock.sleep(TICK_S)
    watcher.check()


@pytest.fixture
def rig():
    rig = LockstepRig(arms=["follower_left", "follower_right"])
    yield rig
    rig.close()


@pytest.fixture
def pair(rig, tmp_path):
    fields = {"interface": "yam_lockstep", "can_options": {"rig": rig.name}, "gripper_stops_rad": STOPS_RAD}
    robot = BiYamFollower(
        BiYamFollowerConfig(
            calibration_dir=tmp_path,
            isolation="lockstep",
            left_arm_config=FollowerArmConfig(channel="follower_left", **fields),
            right_arm_config=FollowerArmConfig(channel="follower_right", max_relative_target=0.3, **fields),
        )
    )
    yield from connected(robot, FREE_PAIR)


@pytest.fixture
def single(rig, tmp_path):
    robot = YamFollower(
        YamFollowerConfig(
            channel="follower_left",
            interface="yam_lockstep",
            can_options={"rig": rig.name},
            gripper_stops_rad=STOPS_RAD,
            calibration_dir=tmp_path,
            isolation="lockstep",
            use_degrees=True,
        )
    )
    yield from connected(robot, FREE_DEGREES)


def connected(robot, free):
    robot.connect()
    start = {key: value for key, value in robot.get_observation().items() if key in robot.action_features}
    try:
        lead(robot, free)
        watcher = Watcher(robot)
        yield robot, watcher
        assert watcher.checked
        lead(robot, start)
    finally:
        robot.disconnect()


@for_all(short=60, action=actions(FREE_PAIR))
def test_two_arms_take_any_action_or_refuse_it(pair, action):
    check_action(*pair, action)


@for_all(short=60, action=actions(FREE_DEGREES))
def test_one_arm_in_degrees_takes_any_action_or_refuses_it(single, action):
    check_action(*single, action)
