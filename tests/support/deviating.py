"""Arms of the rig that differ from their profiles as a seed says, by up to a fifth, for the tests of tuning."""

import numpy as np
import yaml

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.world.world_model import carried

CHANNEL = "only"
SHARE = 0.2
VISCOUS_NM_S = [0.2, 0.2, 0.2, 0.05, 0.05, 0.05]
STOPS = [3.25, -3.3]


def deviation(seed, payload_kg=0.3, arm="yam", gripper="linear_4310"):
    """Its row in a scene."""
    arm, gripper = resolve_profiles(arm, gripper)
    links = [body.name for body in (*arm.bodies, *gripper.bodies)]
    rng = np.random.default_rng(seed)

    def factor(*shape):
        return rng.uniform(1.0 - SHARE, 1.0 + SHARE, shape).tolist()

    return {
        "mass": {link: factor() for link in links},
        "centre": {link: factor(3) for link in links},
        "friction": factor(arm.joint_count),
        "viscous_nm_s": VISCOUS_NM_S,
        "payload_mass_kg": payload_kg,
        "payload_com_m": rng.uniform(-0.05, 0.05, 3).tolist(),
    }


def scene(folder, deviation, **fields):
    """Path of a scene with one such arm, which lies at rest on a table."""
    row = {"channel": CHANNEL, "role": "follower", "arm": "yam", "gripper": "linear_4310", "position_m": [0, 0, 0]}
    table = {"name": "table", "size_m": [2.0, 2.0, 0.04], "center_m": [0, 0, -0.02]}
    path = folder / "deviating.yaml"
    document = {"name": "deviating", "arms": [row | {"deviation": deviation, "stops_rad": STOPS} | fields]}
    path.write_text(yaml.safe_dump(document | {"furniture": [table]}))
    return str(path)


def true_gravity(path):
    """Model of the arm of such a scene as it is."""
    (row,) = load_scene(path).arms
    profiles = resolve_profiles(row.arm, row.gripper)
    return GravityModel(*row.deviation.apply(*profiles), load=carried(row.deviation))
