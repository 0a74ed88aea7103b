"""The operators of the packaged tasks, in a world that runs faster than time; the control loops' stand-in is short."""

import copy

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.script import make_setup
from lerobot_robot_yam.rig.operator.task_scripts import CATALOG, make_script
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.scene.tasks import PICK_AND_PLACE, SCRIPTS
from tests.support.stand_in import StandIn, described
from tests.support.tiers import spread

ARMS = {"arms": ["follower_left", "follower_right"]}
SPEED_RAD_S = 1.2


class Watched(StandIn):
    """Remembers how fast the hands were asked to move."""

    fastest_rad_s = 0.0

    def pull(self, side, times_s, q_rad, trigger):
        speed = np.abs(np.diff(q_rad, axis=0)) / np.diff(times_s)[:, None]
        self.fastest_rad_s = max(self.fastest_rad_s, float(speed.max()))
        super().pull(side, times_s, q_rad, trigger)


def ready(task: str, **options):
    """World and operator of a task, with the arms at their waiting poses."""
    scene = load_scene(task, {**ARMS, **options})
    world = Watched(scene, tuple(row.channel.removeprefix("follower_") for row in scene.arms))
    script = make_script(world, described(scene), task)
    script.begin()
    return world, script


def attempted(world: StandIn, script, seed: int) -> dict:
    """The judge's word on one attempt, and how long it took with the way home."""
    world.judge.place(script.setup.task.name, seed)
    begun = world.now()
    script.attempt()
    took_s = world.now() - begun
    world.wait(0.5)
    return {**world.judge.state(), "took_s": took_s}


def test_every_script_has_an_operator():
    assert tuple(CATALOG) == (*SCRIPTS, PICK_AND_PLACE.name)


@pytest.mark.parametrize("task", spread(SCRIPTS, tuple(SCRIPTS).index("lift_and_place")))
def test_the_task_is_done_and_the_arms_wait_again(task):
    world, script = ready(task)
    state = attempted(world, script, seed=11)
    assert state["success"], state
    assert world.fastest_rad_s < 1.01 * SPEED_RAD_S
    for side, q in world.look().follower_rad.items():
        assert q == pytest.approx(script.setup.home_rad(side), abs=0.03)
    assert all(opening > 0.9 for opening in world.look().opening.values())
    if task == "lift_and_place":
        assert state["since_s"] < 7.0 and state["took_s"] < 9.0


@pytest.mark.long
@pytest.mark.parametrize("task", SCRIPTS)
def test_it_is_done_from_wherever_things_are(task):
    world, script = ready(task)
    won = {seed: attempted(world, script, seed)["success"] for seed in range(100, 125)}
    assert sum(won.values()) >= 24, won


@pytest.mark.long
def test_one_arm_is_enough_where_one_is_used():
    world, script = ready("lift_and_place", arms=["follower_left"])
    assert attempted(world, script, seed=2)["success"]


def test_a_cube_moved_during_the_reach_is_taken_from_its_new_place():
    world, script = ready("lift_and_place")
    begun = world.now()

    def snatch():
        if world.now() > begun + 1.2:  # when the hand is on its way down
            world.put_back(np.array([0.30, 0.30, 0.0225]))
            world.before_tick = None

    world.before_tick = snatch
    state = attempted(world, script, seed=4)
    assert state["success"], state


def test_a_cube_out_of_reach_is_left_alone_and_the_arms_wait_again():
    world, script = ready("lift_and_place")
    world.judge.place("lift_and_place", 0)
    world.put_back(np.array([0.75, 0.3, 0.0225]))
    script.attempt()
    assert not world.judge.state()["success"]
    for side, q in world.look().follower_rad.items():
        assert q == pytest.approx(script.setup.home_rad(side), abs=0.03)


@pytest.fixture(scope="module")
def scenes():
    return {task: described(load_scene(task, ARMS)) for task in SCRIPTS}


def _without(task, change):
    def applied(scenes):
        scene = copy.deepcopy(scenes[task])
        change(scene)
        return scene

    return applied


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (_without("drawer", lambda scene: scene["tasks"].clear()), "has no task 'drawer'; it has: no tasks"),
        (_without("drawer", lambda scene: scene["homes"].pop("right")), "a waiting place of each.*right"),
        (_without("drawer", lambda scene: scene["arms"].clear()), "needs followers"),
        (_without("handover", lambda scene: scene["places"].clear()), "a place called middle"),
        (_without("handover", lambda scene: scene["arms"].pop()), "needs two arms"),
        (_without("insertion", lambda scene: scene["tasks"][0]["success"].pop()), "region in the frame of the block"),
        (_without("drawer", lambda scene: scene["tasks"][0].update(name="ajar")), "'drawer'; it has: ajar"),
        (_without("mobile_tables", lambda scene: scene["stands"].pop("between")), "the stands .*between"),
        (_without("mobile_tables", lambda scene: scene["places"].clear()), "the place put_down"),
    ],
)
def test_a_scene_that_lacks_something_is_refused_by_name(scenes, change, text):
    scene = change(scenes)
    task = next(task for task in SCRIPTS if scene["name"] == task)
    with pytest.raises(ConfigError, match=text):
        make_script(None, scene, task)


def test_a_task_without_a_script_has_no_operator(scenes):
    scene = copy.deepcopy(scenes["drawer"])
    scene["tasks"][0]["name"] = "ajar"
    assert make_setup(scene, "ajar").task.does == "ajar"
    with pytest.raises(ConfigError, match="task ajar has no scripted operator; give it a script"):
        make_script(None, scene, "ajar")
    scene["tasks"][0]["script"] = "drawer"
    assert type(make_script(None, scene, "ajar")) is CATALOG["drawer"]
