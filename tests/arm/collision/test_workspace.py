"""Workspace configs: they travel as plain values, and nonsense is refused by name."""

import dataclasses
import json

import draccus
import pytest

from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ConfigError

FULL = {
    "base_position_m": [0.0, 0.25, 0.0],
    "base_yaw_rad": 0.3,
    "floor_z_m": 0.0,
    "keep_out": [{"name": "camera mast", "center_m": [0.4, 0, 0.3], "size_m": [0.05, 0.05, 0.6], "yaw_rad": 0.1}],
    "collision_margin_m": 0.02,
}


def test_it_travels_in_an_arm_config_as_yaml_and_as_json():
    config = draccus.decode(ArmConfig, {"channel": "can0", "workspace": FULL})
    assert config.workspace.keep_out == [
        KeepOut(name="camera mast", center_m=[0.4, 0.0, 0.3], size_m=[0.05, 0.05, 0.6], yaw_rad=0.1)
    ]
    assert ArmConfig(**json.loads(json.dumps(dataclasses.asdict(config)))).workspace == config.workspace
    assert WorkspaceConfig.from_mapping(dataclasses.asdict(config.workspace)) == config.workspace
    config.workspace.check("left")


def test_as_made_nothing_is_limited():
    assert not WorkspaceConfig().limits_anything
    for one in ({"floor_z_m": -0.1}, {"collision_margin_m": 0.0}, {"keep_out": FULL["keep_out"]}):
        assert WorkspaceConfig.from_mapping(one).limits_anything


@pytest.mark.parametrize(
    "values, complaint",
    [
        ({"floor": 0.0}, "floor_z_m"),
        ({"keep_out": [{"centre_m": [0, 0, 0]}]}, "center_m"),
        ({"keep_out": [3]}, "list of boxes"),
        ({"keep_out": "mast"}, "list of boxes"),
    ],
)
def test_unknown_keys_are_refused_with_the_known_ones(values, complaint):
    with pytest.raises(ConfigError, match=complaint):
        WorkspaceConfig.from_mapping(values)


@pytest.mark.parametrize(
    "values, complaint",
    [
        ({"base_position_m": [0, 0]}, "base_position_m"),
        ({"base_position_m": None}, "base_position_m"),
        ({"base_yaw_rad": float("nan")}, "base_yaw_rad"),
        ({"floor_z_m": float("inf")}, "floor_z_m"),
        ({"floor_z_m": "table"}, "floor_z_m"),
        ({"collision_margin_m": -0.01}, "in metres"),
        ({"collision_margin_m": 20}, "in metres"),
        ({"keep_out": [{"name": "mast", "size_m": [0.1, 0.1, 0.0]}]}, "'mast'.*above zero"),
        ({"keep_out": [{"name": "mast", "size_m": [1, 1, 1], "center_m": [0, 0]}]}, "'mast' center_m"),
        ({"keep_out": [{"name": "a", "size_m": [1, 1, 1]}, {"name": "a", "size_m": [1, 1, 1]}]}, "different names"),
    ],
)
def test_what_cannot_be_meant_is_refused_naming_the_arm(values, complaint):
    with pytest.raises(ConfigError, match=f"left: .*{complaint}"):
        WorkspaceConfig.from_mapping(values).check("left")
