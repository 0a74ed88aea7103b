"""Where a data set is, and the names of a feature's values, in each form that LeRobot writes."""

import pytest
from lerobot.utils.constants import HF_LEROBOT_HOME

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.layout import locate, value_names


@pytest.mark.parametrize(
    "names", [["x", "y"], {"motors": ["x", "y"]}, {"y": 1, "x": 0}], ids=["list", "older", "of the RL stack"]
)
def test_value_names(names):
    assert value_names({"names": names}) == ("x", "y")


def test_values_without_names():
    assert value_names({"names": None}) == value_names({}) == ()


def test_a_directory_a_stored_name_and_what_is_neither(tmp_path):
    assert locate(str(tmp_path)) == tmp_path
    stored = HF_LEROBOT_HOME / "somebody" / "lifts_cubes"
    (stored / "meta").mkdir(parents=True)
    assert locate("somebody/lifts_cubes") == stored
    with pytest.raises(ConfigError, match="somebody/else_entirely is no directory"):
        locate("somebody/else_entirely")
