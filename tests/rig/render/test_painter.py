"""What is left out of a picture is not in it."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.rig.render.painter import Sight

ASPECT = 4 / 3
WORLD = """<mujoco><visual><map znear="0.01"/></visual><statistic extent="1"/><worldbody>
<geom name="floor" type="plane" size="4 4 .1" pos="0 0 -.7"/>
<geom name="table" type="box" size="1 .6 .02" pos="0 0 -.02"/>
{things}
<body name="eye" mocap="true"><camera name="eye" fovy="60"/></body></worldbody></mujoco>"""
DOWN, AHEAD = [1.0, 0.0, 0.0, 0.0], [0.70710678, 0.70710678, 0.0, 0.0]


def looking(model, position_m, quat):
    """Shapes that may be seen, by name, and whether the sky may be."""
    data = mujoco.MjData(model)
    data.mocap_pos[0], data.mocap_quat[0] = position_m, quat
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    seen, sky = Sight(model, 0, ASPECT).seen(data)
    return {model.geom(int(i)).name for i in np.flatnonzero(seen)}, sky


@pytest.mark.parametrize(
    "position_m, quat, behind",
    [
        ([0.0, 0.0, 0.5], DOWN, False),
        ([0.0, 0.4, 0.5], DOWN, True),  # over the table's edge
        ([0.0, 0.0, 1.2], DOWN, True),  # all of the table and more
        ([0.0, 0.0, 0.5], AHEAD, True),
        ([0.0, 0.0, 0.005], DOWN, True),  # the table is nearer than what is drawn at all
        ([0.0, 0.0, -0.3], DOWN, True),  # below it
    ],
)
def test_floor_and_sky_are_left_out_where_the_table_fills_the_picture(position_m, quat, behind):
    seen, sky = looking(mujoco.MjModel.from_xml_string(WORLD.format(things="")), position_m, quat)
    assert ("floor" in seen, sky) == (behind, behind)


def test_a_table_that_is_seen_through_hides_nothing():
    model = mujoco.MjModel.from_xml_string(WORLD.format(things=""))
    model.geom("table").rgba[3] = 0.5
    assert looking(model, [0.0, 0.0, 0.5], DOWN) == ({"floor", "table"}, True)


def test_what_reaches_into_the_picture_is_seen_and_what_is_far_beside_it_is_not():
    width_m = ASPECT * 0.5 * np.tan(np.radians(30.0))  # from the middle to the picture's right edge, on the table
    reach_m = np.sqrt(3.0) * 0.02 / np.cos(np.arctan(width_m / 0.5))  # of a cube's bounding ball, along the table
    for x, inside in ((0.0, True), (width_m + 0.019, True), (width_m + reach_m + 0.001, False), (-0.9, False)):
        cube = f'<geom name="cube" type="box" size=".02 .02 .02" pos="{x} 0 0"/>'
        seen, _ = looking(mujoco.MjModel.from_xml_string(WORLD.format(things=cube)), [0.0, 0.0, 0.5], DOWN)
        assert ("cube" in seen) is inside, x
