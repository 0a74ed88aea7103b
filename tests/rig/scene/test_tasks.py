"""Tasks as a scene file says them."""

import re

import numpy as np
import pytest
import yaml

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.scene import SCENES, load_scene
from lerobot_robot_yam.rig.scene.tasks import SCRIPTS
from lerobot_robot_yam.rig.simulation.judge import Judge
from lerobot_robot_yam.rig.world.world import World
from tests.support.paths import ROOT

SCENE = """
name: mine
extends: bimanual_table
furniture:
  - {name: table, size_m: [2.2, 1.4, 0.04], center_m: [-0.25, 0.0, -0.02]}
  - {name: lid, center_m: [0.5, 0, 0], size_m: [0.1, 0.1, 0.01], mass_kg: 0.1, joint:
      {kind: hinge, axis: [0, 1, 0], range: [0, 1]}}
tasks: [%s]
"""
TASK = {
    "name": "tidy",
    "description": "Tidy up.",
    "time_limit_s": 5.0,
    "randomise": [{"thing": "cube", "x_m": [0.2, 0.3]}],
    "success": [{"prop": "cube", "lifted_m": 0.05}],
}


def load(tmp_path, **changes):
    path = tmp_path / "mine.yaml"
    path.write_text(SCENE % yaml.safe_dump({**TASK, **changes}, default_flow_style=True).strip())
    return load_scene(path)


def test_a_lab_writes_its_own_table_on_top_of_ours(tmp_path):
    scene = load(tmp_path, script="lift_and_place")
    assert scene.name == "mine" and [thing.name for thing in scene.things] == ["table", "lid", "cube"]
    assert scene.channels == load_scene().channels and len(scene.cameras) == len(load_scene().cameras)
    (task,) = scene.tasks
    assert (task.name, task.does, task.time_limit_s) == ("tidy", "lift_and_place", 5.0)
    np.testing.assert_array_equal(task.randomise[0].x_m, [0.2, 0.3])


def test_a_scene_extends_a_file_beside_it_and_only_one_deep(tmp_path):
    load(tmp_path)
    (tmp_path / "other.yaml").write_text("name: other\nextends: mine.yaml\n")
    with pytest.raises(ConfigError, match="extends"):
        load_scene(tmp_path / "other.yaml")
    (tmp_path / "other.yaml").write_text("name: other\nextends: moon\n")
    with pytest.raises(ConfigError, match="unknown scene 'moon'"):
        load_scene(tmp_path / "other.yaml")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"name": ""}, "unique, non-empty names"),
        ({"time_limit_s": 0}, "time_limit_s"),
        ({"success": []}, "stages of success"),
        ({"script": "juggle"}, "script is one of .*'juggle'"),
        ({"randomize": []}, "unknown keys.*randomize"),
        ({"randomise": [{"thing": "ball", "x_m": [0, 1]}]}, "randomise: there is no 'ball'; .*cube"),
        ({"randomise": [{"thing": "cube"}]}, "cube needs bounds"),
        ({"randomise": [{"thing": "cube", "x_m": [1, 0]}]}, "cube needs bounds"),
        ({"randomise": [{"thing": "table", "x_m": [0, 1]}]}, "table can be given x_m"),
        ({"randomise": [{"thing": "cube", "position": [0, 1]}]}, "no position"),
        ({"randomise": [{"thing": "lid", "x_m": [0, 1]}]}, "lid can be given a position"),
        ({"randomise": [{"thing": "lid", "position": [0, 2]}]}, "within its joint's range"),
        ({"success": [{}]}, "needs a prop or a joint"),
        ({"success": [{"prop": "cube"}]}, "names a prop and conditions"),
        ({"success": [{"lifted_m": 0.1}]}, "names a prop and conditions"),
        ({"success": [{"prop": "ball", "still": True}]}, "there is no 'ball'"),
        ({"success": [{"prop": "table", "still": True}]}, "'table' is no prop"),
        ({"success": [{"joint": "lid"}]}, "joint_range"),
        ({"success": [{"joint": "table", "joint_range": [0, 1]}]}, "'table' has no joint"),
        ({"success": [{"joint": "lid", "joint_range": [1, 0]}]}, "least, largest"),
        ({"success": [{"prop": "cube", "held_by": "leader_left"}]}, "held_by is one of .*follower_left"),
        ({"success": [{"prop": "cube", "still": True, "for_s": -1}]}, "for_s"),
        ({"success": [{"prop": "cube", "inside": {"center_m": [0, 0, 0], "radius_m": 0}}]}, "radius_m"),
        ({"success": [{"prop": "cube", "inside": {"center_m": [0, 0, 0], "frame": "moon"}}]}, "no 'moon'"),
    ],
)
def test_a_task_with_an_unknown_name_or_impossible_value_is_refused(tmp_path, changes, text):
    with pytest.raises(ConfigError, match=text):
        load(tmp_path, **changes)


def test_the_scene_in_the_documentation_works(tmp_path):
    text = (ROOT / "docs" / "scenes.md").read_text()
    (tmp_path / "lab.yaml").write_text(re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)[0])
    world = World(load_scene(tmp_path / "lab.yaml"))
    judge = Judge(world)
    judge.place("pen_into_box", 0)
    world.step(800)
    assert not judge.update() and judge.state()["stage"] == 0
    assert world.data.joint("lid").qpos[0] > np.pi / 2  # it stays open
    assert np.linalg.norm(world.data.body("box").xpos - [0.4, 0.2, 0.0]) < 0.01


@pytest.mark.parametrize("name", SCRIPTS)
def test_each_packaged_task_has_a_scene(name):
    assert name in SCENES
    scene = load_scene(name, {"operator": name})
    (task,) = scene.tasks
    assert task.name == task.does == name and task.description.endswith(".")
    whole = "top" if scene.base is None else "base"
    assert {whole, "wrist_left", "wrist_right"} <= {camera.name for camera in scene.cameras}
    assert set(scene.homes) == {"left", "right"}


def test_the_operator_of_a_task_is_known_only_where_the_task_is():
    with pytest.raises(ConfigError, match="operator must be one of .*'drawer'"):
        load_scene(options={"operator": "drawer"})
