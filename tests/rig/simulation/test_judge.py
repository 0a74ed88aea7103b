"""Tasks in the simulated world: starts by a seed, contacts, and the rig's verdicts."""

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.scene.tasks import SCRIPTS
from lerobot_robot_yam.rig.simulation.judge import Contacts, Judge
from lerobot_robot_yam.rig.world.world import World
from tests.support.rigged import lockstep_rig, rig_of

ARMS = {"arms": ["follower_left", "follower_right"]}


def strewn(world: World, name: str, seed: int) -> np.ndarray:
    """qpos of everything but the arms."""
    judge = Judge(world)
    judge.place(name, seed)
    things = [thing.name for thing in world.scene.things if not thing.fixed]
    return np.concatenate([world.data.joint(name).qpos for name in things])


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_seed_always_means_the_same_and_another_one_something_else(name):
    world, other = World(load_scene(name, ARMS)), World(load_scene(name, ARMS))
    other.step(100)
    first = strewn(world, name, 7)
    world.step(50)
    np.testing.assert_array_equal(strewn(world, name, 7), first)
    np.testing.assert_array_equal(strewn(other, name, 7), first)
    assert np.abs(strewn(world, name, 8) - first).max() > 1e-3


@pytest.mark.parametrize("name", SCRIPTS)
def test_things_are_strewn_within_their_bounds_lie_still_and_clear_of_the_arms(name):
    scene = load_scene(name, ARMS)
    world = World(scene)
    contacts = Contacts(world)
    judge = Judge(world)
    (task,) = scene.tasks
    seen: dict[str, list[np.ndarray]] = {draw.thing: [] for draw in task.randomise}
    for seed in range(6):
        judge.place(name, seed)
        placed = {thing.name: world.data.body(thing.name).xpos.copy() for thing in scene.props}
        for draw in task.randomise:
            if draw.x_m is not None:
                x, y, _ = placed[draw.thing]
                assert draw.x_m[0] <= x <= draw.x_m[1] and draw.y_m[0] <= y <= draw.y_m[1]
                seen[draw.thing].append(placed[draw.thing])
        world.step(300)
        touching, _ = contacts.look()
        for prop, before in placed.items():
            assert np.linalg.norm(world.data.body(prop).xpos - before) < 2e-3, f"{prop} moved by itself"
            assert touching[prop] == {scene.furniture[0].name}
        assert not judge.update()
        assert judge.state() | {"since_s": 0} == {
            "task": name,
            "seed": seed,
            "success": False,
            "failed": False,
            "reason": "",
            "since_s": 0,
            "stage": 0,
            "stages": len(task.success),
        }
    for points in seen.values():
        assert not points or np.ptp(points, axis=0)[:2].min() > 0.01


rig = lockstep_rig(*ARMS["arms"], scene="lift_and_place")


def test_doing_nothing_fails_when_time_is_over(rig):
    assert rig.task_state() == {"task": None}
    rig.task("lift_and_place", seed=3)
    rig.sleep(14.9)
    state = rig.task_state()
    assert not state["success"] and not state["failed"] and state["since_s"] == pytest.approx(14.9, abs=0.02)
    rig.sleep(2.0)
    state = rig.task_state()
    assert state["failed"] and not state["success"] and "time limit of 15 s" in state["reason"]
    assert state["since_s"] == pytest.approx(15.0, abs=0.02)  # of the verdict
    kinds = {"task_placed": {"seed": 3}, "task_failed": {"seed": 3, "reason": state["reason"]}}
    for kind, details in kinds.items():
        (event,) = [event for event in rig.events() if event["kind"] == kind]
        assert event.items() >= {"task": "lift_and_place", **details}.items()


@pytest.mark.parametrize("limit_s", [1.0, 16.0])
def test_an_attempt_may_replace_the_time_limit(rig, limit_s):
    rig.task("lift_and_place", seed=3, time_limit_s=limit_s)
    rig.sleep(limit_s - 0.1)
    assert not rig.task_state()["failed"]
    rig.sleep(0.2)
    assert f"time limit of {limit_s:g} s" in rig.task_state()["reason"]


def test_a_new_attempt_forgets_the_old_one(rig):
    rig.task("lift_and_place", seed=0)
    first = rig.state()["props"]["cube"]["pos"]
    rig.place("cube", (1.5, 0.0, 0.0))
    rig.sleep(1.0)
    assert "fell off the table" in rig.task_state()["reason"]
    rig.task("lift_and_place", seed=0)
    assert rig.state()["props"]["cube"]["pos"] == first
    rig.sleep(0.1)
    assert rig.task_state() | {"since_s": 0.1} == {
        "task": "lift_and_place",
        "seed": 0,
        "success": False,
        "failed": False,
        "reason": "",
        "since_s": 0.1,
        "stage": 0,
        "stages": 2,
    }


def test_the_scene_and_the_state_tell_of_tasks_and_furniture():
    with rig_of("lockstep", scene="drawer", seed=5, **ARMS) as rig:
        scene, state = rig.scene(), rig.state()
        assert scene["seed"] == 5 and scene["homes"]["left"] and scene["tasks"][0]["name"] == "drawer"
        assert [thing["name"] for thing in scene["furniture"]] == ["table", "drawer"]
        assert state["joints"] == {"drawer": 0.0} and set(state["furniture"]) == {"table", "drawer"}
        rig.task("drawer", seed=1)
        assert 0.0 < rig.state()["joints"]["drawer"] < 0.015


@pytest.mark.parametrize(
    ("name", "seed", "text"),
    [("juggle", 0, "no task 'juggle'; the scene has lift_and_place"), ("lift_and_place", -1, "whole number")],
)
def test_a_task_that_cannot_be_set_is_refused(rig, name, seed, text):
    with pytest.raises(ConfigError, match=text):
        rig.task(name, seed=seed)


def test_a_scene_without_tasks_says_so():
    with rig_of("lockstep", **ARMS) as rig:
        with pytest.raises(ConfigError, match="the scene has no tasks"):
            rig.task("lift_and_place", seed=0)


def test_held_is_touched_by_both_fingers():
    world = World(load_scene("lift_and_place", ARMS))
    contacts = Contacts(world)
    grasp = world.data.site("follower_left/grasp_site").xpos.copy()
    world.set_pose("follower_left", opening=0.0475 / 0.095)  # a gap of 47.5 mm about the 45 mm of the cube
    world.model.opt.gravity[2] = 0.0
    for off_m, touching, held in ((0.0, set(), set()), (0.003, {"follower_left"}, set())):
        world.put("cube", grasp + [0.0, off_m, 0.0], np.array([1.0, 0.0, 0.0, 0.0]))
        world.step(1)
        found = contacts.look()
        assert (found[0]["cube"], found[1]["cube"]) == (touching, held)
    world.put("cube", grasp, np.array([1.0, 0.0, 0.0, 0.0]))
    world.set_pose("follower_left", opening=0.044 / 0.095)
    world.step(1)
    assert contacts.look()[1]["cube"] == {"follower_left"}


def test_a_drawer_that_is_pulled_to_its_stop_is_open():
    """The stop gives way a little, so a pulled drawer is out farther than its range."""
    with rig_of("lockstep", scene="drawer", arms=["follower_left"]) as rig:
        rig.task("drawer", 3)
        world = rig.device.world
        address = world.model.joint("drawer").dofadr[0]
        world.data.qfrc_applied[address] = 30.0
        rig.sleep(1.5)
        assert world.data.qpos[world.model.joint("drawer").qposadr[0]] > 0.14
        assert rig.task_state()["success"]
