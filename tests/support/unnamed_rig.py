"""A virtual rig as it comes out of the box: the default scene with other names of channels and cameras."""

import yaml

from lerobot_robot_yam.rig.scene import scene as scenes
from lerobot_robot_yam.rig.scene.scene import DEFAULT_SCENE

# What the kernel calls the adapters, by the arm behind each: in the order of discovery, which is no order.
SHUFFLED = {
    "follower_left": "can2",
    "follower_right": "can0",
    "leader_left": "can3",
    "leader_right": "can1",
}
CAMERAS = {"top": "video4", "wrist_left": "video0", "wrist_right": "video2"}


def write_scene(path, channels=SHUFFLED, cameras=CAMERAS):
    """A scene file in which arms and cameras have these names, by those of the default scene. Returns its path."""
    document = yaml.safe_load((scenes._DIRECTORY / f"{DEFAULT_SCENE}.yaml").read_text())
    for arm in document["arms"]:
        arm["channel"] = channels[arm["channel"]]
    document["cameras"] = [camera for camera in document["cameras"] if camera["name"] in cameras]
    for camera in document["cameras"]:
        camera["name"] = cameras[camera["name"]]
        if "body" in camera:
            arm, _, body = camera["body"].partition("/")
            camera["body"] = f"{channels[arm]}/{body}"
    path.write_text(yaml.safe_dump(document))
    return str(path)
