"""The scripted operator before a world that runs faster than time, and its process before a live rig."""

import copy
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.control import RigControl, running_rig
from lerobot_robot_yam.rig.operator.hands import Interrupted
from lerobot_robot_yam.rig.operator.operator import RigHands
from lerobot_robot_yam.rig.operator.script import SIDES, Setup, make_setup
from lerobot_robot_yam.rig.operator.task_scripts import CATALOG, make_script
from lerobot_robot_yam.rig.scene.scene import Scene, load_scene
from lerobot_robot_yam.session.arm_session import ArmSession
from tests.support import transfers
from tests.support.stand_in import StandIn, described
from tests.support.tiers import spread


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene()


@pytest.fixture(scope="module")
def description(scene):
    return described(scene)


@pytest.fixture(scope="module")
def setup(description) -> Setup:
    return make_setup(description, "pick_and_place")


@pytest.fixture
def world(scene):
    return StandIn(scene)


@pytest.fixture
def task(setup, world):
    task = CATALOG["pick_and_place"](world, setup)
    task.begin()
    return task


def kinds(world: StandIn) -> list[str]:
    return [event["kind"] for event in world.events]


@pytest.fixture(scope="module")
def cycle(scene, setup):
    """The world after the prop was carried there and back, and its states, 30 a second: qpos (k, nq), qvel (k, nv)."""
    world = StandIn(scene)
    task = CATALOG["pick_and_place"](world, setup)
    task.begin()
    states, begun, data = [], world.now(), world.world.data

    def remember():
        if world.now() >= begun + len(states) / 30:
            states.append((data.qpos.copy(), data.qvel.copy()))

    world.before_tick = remember
    assert all(task.work() for _ in range(4))
    world.wait(0.5)
    return world, *map(np.array, zip(*states, strict=True))


@pytest.mark.long
def test_there_and_back(cycle):
    world, *_ = cycle
    assert kinds(world) == ["transfer"] * 4 and len(transfers.cycles(world.events)) == 2
    places = [(event["from"]["place"], event["to"]["place"]) for event in world.events]
    assert places == [("A", "M"), ("M", "B"), ("B", "M"), ("M", "A")]
    for event in world.events:
        assert event["lift_m"] >= 0.08 and event["carry_m"] >= 0.15
    assert world.events[1]["end"] - world.events[0]["start"] < 13.0
    assert world.max_hand_nm < 5.0  # it pulls, it does not wrench


def test_both_arms_work_without_a_pause_and_no_two_carries_are_alike(cycle):
    world, qpos, qvel = cycle
    followers = [f"follower_{side}" for side in SIDES]
    speeds = np.hstack([qvel[:, world.world.joint_dofs(channel)] for channel in followers])
    assert (np.abs(speeds) < 0.02).all(axis=1).mean() < 0.05
    for channel in followers:
        assert np.ptp(qpos[:, world.world.joint_addresses(channel)], axis=0).min() > 0.3, "every joint moves"
    ends = [event["to"] for event in world.events]
    off = [end["xy_m"] - world.world.scene.places[end["place"]][:2] for end in ends]
    assert np.ptp(off, axis=0).min() > 0.02, "where it is put down is drawn"


@pytest.mark.long
def test_two_dozen_transfers_without_a_miss(task, world):
    assert all(task.work() for _ in range(24))
    assert kinds(world).count("transfer") >= 23 and "drop" not in kinds(world)


@pytest.mark.parametrize(
    ("xy_m", "yaw_rad"),
    spread([((0.25, 0.35), 0.3), ((0.38, 0.15), 0.78), ((0.32, 0.05), 1.2), ((0.36, -0.2), 0.5)], 0),
)
def test_it_takes_the_cube_from_where_it_is(task, world, xy_m, yaw_rad):
    joint = world.world.data.joint("cube")
    joint.qpos[:] = [*xy_m, 0.02, np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)]
    goal = world.world.scene.places["B"]
    for _ in range(3):
        task.work()
        found = world.look().things["cube"].position_m
        if (np.abs(found - goal) < [0.055, 0.045, 0.01]).all():
            return
    raise AssertionError(f"the cube is at {found}, not at {goal}")


@pytest.mark.long
def test_a_missed_grasp_is_tried_again(task, world):
    started = world.now()

    def snatch():
        if world.now() > started + 1.6:  # when the hand is already on its way down
            world.put_back(np.array([0.36, 0.2, 0.02]))
            world.before_tick = None

    world.before_tick = snatch
    assert not task.work()
    assert task.work()
    world.wait(0.3)
    assert kinds(world)[-1] == "transfer"


def test_a_prop_out_of_reach_is_put_back(task, world):
    world.put_back(np.array([0.75, 0.0, 0.02]))
    assert not task.work()
    assert task.work()


@pytest.mark.long
def test_a_follower_that_stops_following_is_waited_for(task, world):
    """As between two episodes, when nobody passes the leader's pose on."""
    started = world.now()

    def pause():
        world.following = not started + 2.0 < world.now() < started + 7.0  # while the fingers close

    world.before_tick = pause
    for _ in range(4):
        task.work()
    world.wait(0.3)
    assert kinds(world)[:2] == ["drop", "transfer"]  # at rest half closed, they seem to hold something


def test_switching_off_makes_it_let_go(task, world):
    started = world.now()

    def switch_off():
        world.energised = world.now() < started + 3.0

    world.before_tick = switch_off
    with pytest.raises(Interrupted):
        while True:
            task.work()
    assert not world.held


@pytest.mark.parametrize("missing", ["M", "props", "leader_left"])
def test_a_scene_that_lacks_something_is_refused_by_name(description, missing):
    description = copy.deepcopy(description)
    description["places"].pop(missing, None)
    description["arms"] = [row for row in description["arms"] if row["channel"] != missing]
    if missing == "props":
        description["props"] = []
    with pytest.raises(ConfigError, match="prop" if missing == "props" else missing):
        make_script(RigHands(None, description), description, "pick_and_place")


def test_the_idle_arm_waits_outside_the_middle(setup):
    for home in setup.homes_m.values():
        assert np.linalg.norm((home - setup.places_m["M"])[:2]) > 0.15


@contextmanager
def teleoperated(rig: RigControl) -> Iterator[Callable[[], None]]:
    """All arms up, in their control loops; call the result to pass the leaders' poses on."""
    with ExitStack() as stack:
        sim: dict = {"interface": "yam_sim", "can_options": {"rig": rig.name}}
        leaders, followers = (
            ArmSession([ArmConfig(name=side, channel=f"{role}_{side}", **sim, **kind) for side in SIDES])
            for role, kind in (
                ("leader", {"gripper": "yam_teaching_handle", "start": "float"}),
                ("follower", {"gripper_stops_rad": [3.25, -3.3]}),
            )
        )
        for session in (leaders, followers):
            session.start()
            stack.callback(session.stop)

        def pass_on() -> None:
            for side in SIDES:
                state = leaders[side].observe()
                followers[side].write_target(state.q, 1.0 - state.trigger)

        yield pass_on


def events_of(rig: RigControl, kind: str, count: int, pass_on: Callable[[], None]) -> list[dict]:
    """The first events of a kind, while the arms are teleoperated."""
    deadline = time.monotonic() + 60.0
    while len(found := [event for event in rig.events() if event["kind"] == kind]) < count:
        assert time.monotonic() < deadline, rig.events()
        pass_on()
        time.sleep(1 / 30)
    return found


@pytest.mark.long
@pytest.mark.alone
def test_its_process_attempts_a_task_again_and_again_with_the_next_seed():
    with running_rig(scene="lift_and_place", operator="lift_and_place", seed=5) as rig:
        with teleoperated(rig) as pass_on:
            placed = events_of(rig, "task_placed", 2, pass_on)
        assert [event["seed"] for event in placed][:2] == [5, 6]
        (first,) = [event for event in rig.events() if event["kind"] == "attempt"]
        assert first.items() >= {"task": "lift_and_place", "seed": 5, "success": True, "reason": ""}.items()
        (success,) = [event for event in rig.events() if event["kind"] == "task_success"]
        assert success["seed"] == 5 and success["since_s"] == pytest.approx(first["since_s"], abs=0.02)
