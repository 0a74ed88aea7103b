"""Looks that are drawn from a seed: the same seed the same look, near the usual one, and nothing but looks."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.rig.render.drawing import Look
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.world.world_model import build_world

SEEN = ("light_dir", "light_diffuse", "geom_rgba", "cam_pos", "cam_quat")


@pytest.fixture
def model():
    return build_world(load_scene("lift_and_place"))


def taken(model, seed, amount=1.0):
    """Everything that a look may change, at that seed."""
    Look(model, amount, ["cube"], ["world", "table", "pad"]).take(seed)
    return {key: getattr(model, key).copy() for key in SEEN} | {"ambient": model.vis.headlight.ambient.copy()}


def test_a_seed_has_one_look_whatever_was_before():
    fresh, used = build_world(load_scene("lift_and_place")), build_world(load_scene("lift_and_place"))
    look = Look(used, 1.0, ["cube"], ["world", "table", "pad"])
    for seed in (3, 4, 5):
        look.take(seed)
    expected = taken(fresh, 5)
    for key in SEEN:
        np.testing.assert_array_equal(getattr(used, key), expected[key])


def test_other_seeds_have_other_looks(model):
    usual = {key: getattr(model, key).copy() for key in SEEN}
    one = taken(model, 1)
    for key in SEEN:
        getattr(model, key)[:] = usual[key]
    other = taken(model, 2)
    assert all((one[key] != other[key]).any() for key in SEEN)


def test_a_look_stays_near_the_usual_one_and_touches_only_looks(model):
    before = {name: np.copy(getattr(model, name)) for name in ("body_pos", "geom_size", "geom_pos", "body_mass")}
    usual = {key: getattr(model, key).copy() for key in SEEN}
    arms = [model.body(body).name.startswith("follower") for body in model.geom_bodyid]
    look = Look(model, 1.0, ["cube"], ["world", "table", "pad"])
    for seed in range(30):
        look.take(seed)
        np.testing.assert_array_equal(model.geom_rgba[arms], usual["geom_rgba"][arms])
        assert np.abs(model.geom_rgba - usual["geom_rgba"]).max() < 0.16
        red, green, blue, _ = model.geom("cube").rgba
        assert red > 0.7 and max(green, blue) < 0.25  # still the red cube
        assert np.abs(model.cam_pos - usual["cam_pos"]).max() <= 0.02
        turn = np.empty(3)
        for quat, old in zip(model.cam_quat, usual["cam_quat"], strict=True):
            mujoco.mju_subQuat(turn, quat, old)
            assert np.degrees(np.linalg.norm(turn)) < 5.0
        np.testing.assert_allclose(np.linalg.norm(model.light_dir, axis=1), 1.0)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(model, name), value)


def test_half_the_amount_is_half_as_far(model):
    usual = model.cam_pos.copy()
    Look(model, 0.5, [], []).take(9)
    half = model.cam_pos - usual
    model.cam_pos[:] = usual
    Look(model, 1.0, [], []).take(9)
    np.testing.assert_allclose(model.cam_pos - usual, 2.0 * half)
