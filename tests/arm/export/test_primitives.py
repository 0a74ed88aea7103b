"""Primitives as triangles, looked at by trimesh."""

import numpy as np
import pytest
import trimesh

from lerobot_robot_yam.arm.export.primitives import ball, box, capsule, cylinder, joined

BALL_M3 = 4.0 / 3.0 * np.pi
ROUND = 0.03  # of the volume, that 24 sections of a circle leave out


def seen(mesh):
    return trimesh.Trimesh(*mesh, process=False)


@pytest.mark.parametrize(
    "mesh, volume_m3, half_m",
    [
        (box([0.1, 0.2, 0.3]), 0.006, [0.05, 0.1, 0.15]),
        (cylinder(0.2, 0.5), np.pi * 0.02, [0.2, 0.2, 0.25]),
        (capsule(0.2, 0.5), np.pi * 0.02 + BALL_M3 * 0.008, [0.2, 0.2, 0.45]),
        (ball(), BALL_M3, [1.0, 1.0, 1.0]),
        (ball().scaled([0.1, 0.2, 0.3]), BALL_M3 * 0.006, [0.1, 0.2, 0.3]),
    ],
    ids=["box", "cylinder", "capsule", "ball", "ellipsoid"],
)
def test_a_primitive_is_closed_and_has_its_volume(mesh, volume_m3, half_m):
    solid = seen(mesh)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(volume_m3, rel=ROUND)  # above 0: its faces look outwards
    np.testing.assert_allclose(solid.bounds, [np.negative(half_m), half_m], atol=1e-12)


def test_a_mesh_is_turned_then_moved():
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = seen(box([0.2, 0.4, 0.6]).moved(quarter, np.array([1.0, 2.0, 3.0])))
    np.testing.assert_allclose(moved.bounds, [[0.8, 1.9, 2.7], [1.2, 2.1, 3.3]])


def test_joined_meshes_are_both_there():
    one, other = box([1.0, 1.0, 1.0]), cylinder(0.1, 0.2).moved(np.eye(3), np.array([3.0, 0.0, 0.0]))
    both = seen(joined([one, other]))
    assert both.volume == pytest.approx(seen(one).volume + seen(other).volume)
    np.testing.assert_allclose(both.bounds, [[-0.5, -0.5, -0.5], [3.1, 0.5, 0.5]])
