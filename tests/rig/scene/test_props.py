"""Things on the table: as the file says them, and as physics has them."""

import math

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.props import Thing, check_things
from lerobot_robot_yam.rig.world.world_model import add_things
from lerobot_robot_yam.system.strict_yaml import parse

CUBE = {"name": "cube", "size_m": [0.04, 0.04, 0.04], "center_m": [0.3, 0.1, 0.02], "mass_kg": 0.05}
PEG = {
    "name": "peg",
    "center_m": [0, 0, 0],
    "mass_kg": 0.3,
    "parts": [
        {"size_m": [0.02, 0.02, 0.04], "center_m": [0, 0, 0.02]},
        {"size_m": [0.04, 0.04, 0.02], "center_m": [0, 0, 0.05], "shape": "cylinder"},
        {"size_m": [0.1, 0.1, 0.1], "solid": False},
    ],
}
CABINET = {"name": "cabinet", "center_m": [0.5, 0.2, 0], "yaw_rad": 0.5, "size_m": [0.2, 0.2, 0.1], "mass_kg": 3.0}
SLIDE = {"kind": "slide", "axis": [-1, 0, 0], "range": [0, 0.15], "friction": 2.0, "damping": 5.0}
DRAWER = {
    "name": "drawer",
    "carrier": "cabinet",
    "center_m": [-0.1, 0, 0],
    "size_m": [0.1, 0.1, 0.05],
    "mass_kg": 0.2,
    "joint": SLIDE,
}
LID = {**DRAWER, "name": "lid", "carrier": "", "center_m": [0, 0, 0.1], "joint": {**SLIDE, "kind": "hinge"}}
TABLE = {"name": "table", "size_m": [1, 1, 0.04], "center_m": [0, 0, -0.02]}


def thing(row: dict, **changes) -> Thing:
    return parse(Thing, {**row, **changes}, row["name"])


def world(*things: Thing) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_things(spec, things)
    return spec.compile()


def test_a_single_box_is_a_body_with_its_mass_and_size():
    model = world(thing(TABLE), thing(CUBE))
    assert model.body("cube").mass[0] == pytest.approx(0.05) and model.body("table").mass[0] == 0.0
    assert model.geom("cube").size == pytest.approx([0.02] * 3)
    assert model.nq == 7


def test_solid_parts_share_the_mass_by_volume():
    peg = thing(PEG)
    shaft, handle = 0.02 * 0.02 * 0.04, math.pi * 0.02**2 * 0.02
    model = world(peg)
    assert model.body("peg").mass[0] == pytest.approx(0.3)
    com_z = (shaft * 0.02 + handle * 0.05) / (shaft + handle)
    assert model.body("peg").ipos == pytest.approx([0, 0, com_z])
    assert [int(model.geom(i).contype[0]) for i in range(3)] == [1, 1, 0]
    assert model.geom("peg_1").type[0] == mujoco.mjtGeom.mjGEOM_CYLINDER
    assert model.geom("peg_1").size[:2] == pytest.approx([0.02, 0.01])


def test_a_drawer_slides_on_its_cabinet_wherever_that_stands():
    model = world(thing(DRAWER), thing(CABINET))  # in any order
    data = mujoco.MjData(model)
    data.joint("drawer").qpos = 0.1
    mujoco.mj_forward(model, data)
    along = np.array([math.cos(0.5), math.sin(0.5), 0.0])
    assert data.body("drawer").xpos == pytest.approx(np.array([0.5, 0.2, 0.0]) - 0.2 * along)
    assert data.ncon == 0  # though they overlap
    assert model.joint("drawer").range == pytest.approx([0, 0.15])
    assert model.dof_frictionloss[model.joint("drawer").dofadr[0]] == 2.0
    assert model.dof_damping[model.joint("drawer").dofadr[0]] == 5.0


def test_a_lid_turns_on_its_hinge():
    model = world(thing(LID, joint={**SLIDE, "kind": "hinge", "axis": [0, 1, 0], "pivot_m": [0.05, 0, 0]}))
    data = mujoco.MjData(model)
    data.joint("lid").qpos = 0.15
    mujoco.mj_forward(model, data)
    c, s = math.cos(0.15), math.sin(0.15)
    assert data.body("lid").xpos == pytest.approx([0.05 - 0.05 * c, 0.0, 0.1 + 0.05 * s])


@pytest.mark.parametrize(
    ("prop", "changes", "text"),
    [
        (True, {"mass_kg": 0}, "cube: a prop has a mass"),
        (True, {"joint": SLIDE}, "cube: a prop .* is loose"),
        (True, {"size_m": [0.04, 0, 0.04]}, "above zero"),
        (True, {"size_m": None}, "needs a size_m"),
        (True, {"parts": [{"size_m": [1, 1, 1], "shape": "ball"}]}, "shape is one of .*'ball'"),
        (True, {"parts": [{"size_m": [1, 2, 1], "shape": "cylinder"}]}, "diameter, diameter, length"),
        (True, {"parts": [{"size_m": [1, 1, 1], "quat_wxyz": [0, 0, 0, 0]}]}, "quat_wxyz"),
        (True, {"size_m": None, "parts": [{"size_m": [1, 1, 1], "solid": False}]}, "one must be solid"),
        (True, {"friction": -1}, "friction"),
        (True, {"grips": [{"name": "a"}, {"name": "a"}]}, "grips need unique names"),
        (True, {"grips": [{"name": "a", "turns": 0}]}, "turns"),
        (False, {}, "furniture has a joint and a mass"),
        (False, {"joint": {**SLIDE, "kind": "ball"}}, "kind is one of .*'ball'"),
        (False, {"joint": {**SLIDE, "axis": [0, 0, 0]}}, "axis"),
        (False, {"joint": {**SLIDE, "range": [0.1, 0.2]}}, "with 0 in it"),
        (False, {"joint": {**SLIDE, "damping": -1}}, "damping"),
        (False, {"joint": SLIDE, "carrier": "moon"}, "carrier .*'moon'"),
        (False, {"mass_kg": 0, "carrier": "table"}, "carrier .* asks for a joint"),
    ],
)
def test_a_thing_that_cannot_be_is_refused_by_name(prop, changes, text):
    table, wrong = thing(TABLE), thing(CUBE, **changes)
    with pytest.raises(ConfigError, match=f"scene 'x': .*{text}"):
        check_things([wrong] if prop else [], [table] if prop else [table, wrong], "scene 'x'")


def test_names_are_unique():
    with pytest.raises(ConfigError, match="unique, non-empty names"):
        check_things([thing(CUBE)], [thing(TABLE, name="cube")], "scene 'x'")
