"""Where a data set is."""

import pytest
from lerobot.utils.constants import HF_LEROBOT_HOME

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.datasets.located import locate


def test_a_directory_a_stored_name_and_what_is_neither(tmp_path):
    assert locate(str(tmp_path)) == tmp_path
    stored = HF_LEROBOT_HOME / "somebody" / "lifts_cubes"
    (stored / "meta").mkdir(parents=True)
    assert locate("somebody/lifts_cubes") == stored
    with pytest.raises(ConfigError, match="somebody/else_entirely is no directory"):
        locate("somebody/else_entirely")
