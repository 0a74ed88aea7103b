"""Names of a feature's values, in each form that LeRobot writes."""

import pytest

from lerobot_robot_yam.face.datasets.layout import value_names


@pytest.mark.parametrize(
    "names", [["x", "y"], {"motors": ["x", "y"]}, {"y": 1, "x": 0}], ids=["list", "older", "of the RL stack"]
)
def test_value_names(names):
    assert value_names({"names": names}) == ("x", "y")


def test_values_without_names():
    assert value_names({"names": None}) == value_names({}) == ()
