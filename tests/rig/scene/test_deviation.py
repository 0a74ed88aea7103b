"""Arms that differ from their profiles."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.world.world import World
from tests.support.deviating import CHANNEL, VISCOUS_NM_S, deviation, scene, true_gravity

Q = np.array([0.3, 1.2, 0.9, -0.4, 0.5, 0.2])


def test_the_world_has_the_arm_as_it_deviates(tmp_path):
    row = deviation(4)
    path = scene(tmp_path, row)
    world = World(load_scene(path))
    world.set_pose(CHANNEL, Q, opening=0.0)
    mujoco.mj_forward(world.model, world.data)
    dofs = world.joint_dofs(CHANNEL)
    np.testing.assert_allclose(world.data.qfrc_bias[dofs], true_gravity(path).torque(Q), atol=1e-6)
    np.testing.assert_allclose(world.model.dof_frictionloss[dofs], 0.1 * np.array(row["friction"]))
    assert world.model.dof_damping[dofs].tolist() == VISCOUS_NM_S


@pytest.mark.parametrize(
    "row, says",
    [
        ({"mass": {"link9": 1.1}}, r"only: deviation names the links \['link9'\]; there are base, link1"),
        ({"centre": {"tool": [1, 1, 1]}}, "there are base, link1"),
        ({"mass": {"link2": 0.0}}, "factors of masses are above zero"),
        ({"payload_mass_kg": -0.1}, "a payload is not below"),
        ({"friction": [1.0] * 5}, "deviation.friction takes 6 numbers from zero up"),
        ({"viscous_nm_s": [-1.0] * 6}, "deviation.viscous_nm_s takes 6 numbers from zero up"),
        ({"weight": 1.0}, "unknown keys"),
    ],
)
def test_what_fits_no_arm_is_refused(tmp_path, row, says):
    with pytest.raises(ConfigError, match=says):
        load_scene(scene(tmp_path, row))
