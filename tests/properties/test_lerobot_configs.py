"""Any mapping is parsed by LeRobot's own parser into our configs or refused by it; a device is made of it or refused.

draccus names the field of what it cannot parse; everything that only we can know is a ConfigError when the device is
made.
"""

import functools
import typing

import draccus
import pytest
from draccus.utils import DraccusException
from hypothesis import strategies as st
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig as YamSimCameraConfig  # registers its type
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig, YamFollowerConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.yam_follower import BiYamFollower, YamFollower
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig, YamLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader, YamLeader
from tests.support.cases import documents, for_all, workspaces

ONE = {YamFollowerConfig: YamFollower, YamLeaderConfig: YamLeader}
TWO = {BiYamFollowerConfig: BiYamFollower, BiYamLeaderConfig: BiYamLeader}
NOT_OURS = ("id", "calibration_dir", "left_arm_config", "right_arm_config")  # LeRobot makes paths of the first two
SIDES = {BiYamFollowerConfig: FollowerArmConfig, BiYamLeaderConfig: LeaderArmConfig}


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    return str(tmp_path_factory.mktemp("calibration"))


CHOICES = {
    "arm": ["yam", "big_yam", "yum", "none"],
    "follower_arm": ["yam", "yam_pro", "yum", "none"],
    "gripper": ["linear_4310", "crank_4310", "no_gripper", "claw", "yam_teaching_handle"],
    "start": ["hold", "float", "fly"],
    "isolation": ["process", "thread", "fiber"],
    "channel": ["can0", "follower_left", "", "x" * 300],
    "interface": ["socketcan", "yam_sim", ""],
}


@functools.cache  # to make strategies takes longer than to draw from them
def values(key, hint):
    """Something for one field: of its type, whatever the number is, or now and then anything that YAML can hold."""
    odd = st.sampled_from([0.0, -1.0, 1e308, 5e-324, float("nan"), float("inf"), 10**400])
    number = st.floats(0.01, 4) | st.floats() | odd
    cameras = st.dictionaries(
        st.text(max_size=3),
        st.fixed_dictionaries(
            {"type": st.sampled_from(["yam_sim", "yam_sim", "opencv", "magic"]), "camera": st.text(max_size=3)},
            optional={"width": documents() | st.integers(1, 640), "height": st.none(), "fps": st.integers(-1, 60)},
        ),
        max_size=2,
    )
    if key in CHOICES:
        typed = st.sampled_from(CHOICES[key])
    elif key == "can_options":
        typed = st.fixed_dictionaries({}, optional={"rig": documents(), "channel": st.none(), "scene": documents()})
    elif key == "workspace":
        typed = workspaces()
    elif key == "cameras":
        typed = cameras
    elif "list" in str(hint):
        near = st.lists(st.floats(0.01, 4), min_size=6, max_size=6)
        typed = near | near | st.lists(number, min_size=5, max_size=7) | st.lists(number, max_size=3)
    elif "bool" in str(hint):
        typed = st.booleans()
    else:
        typed = number if "float" in str(hint) else st.text(max_size=5)
    return st.sampled_from([typed] * 8 + [st.none(), documents()]).flatmap(lambda chosen: chosen)


@functools.cache
def hints_of(cls):
    return {name: hint for name, hint in typing.get_type_hints(cls).items() if name in cls.__dataclass_fields__}


@st.composite
def mappings(draw, cls):
    """A config of `cls` as a YAML file says it: the needed fields and a few others, now and then an unknown one."""
    hints = hints_of(cls)
    known = [name for name in hints if name not in NOT_OURS]
    keys = draw(st.lists(st.sampled_from(known), max_size=3, unique=True))
    mapping = {"channel": "can0"} if "channel" in known else {}
    mapping |= {key: draw(values(key, hints[key])) for key in keys}
    return mapping | ({"chanel": 1} if draw(st.integers(0, 19)) == 0 else {})


@st.composite
def pairs(draw, cls, arm):
    """A config of two arms."""
    mapping = draw(mappings(cls))
    for side, channel in (("left", "can0"), ("right", "can1")):
        if draw(st.integers(0, 19)):
            mapping[f"{side}_arm_config"] = draw(mappings(arm)) | {"channel": channel}
    return mapping


def make(cls, device, mapping, directory):
    """Parse and build; whatever fails must be documented."""
    try:
        config = draccus.decode(cls, {**mapping, "calibration_dir": directory})
    except DraccusException as error:
        assert str(error)
        return None
    assert isinstance(config, RobotConfig | TeleoperatorConfig)
    try:
        made = device(config)
    except YamError as error:
        assert str(error)
        return None
    assert not made.is_connected
    assert list(made.action_features) and set(made.action_features.values()) == {float}
    made.disconnect()
    return made


@for_all(
    short=40, data=st.sampled_from(sorted(ONE, key=str)).flatmap(lambda cls: st.tuples(st.just(cls), mappings(cls)))
)
def test_one_arm_is_made_of_any_mapping_or_refused(directory, data):
    cls, mapping = data
    make(cls, ONE[cls], mapping, directory)


@for_all(
    short=40,
    data=st.sampled_from(sorted(TWO, key=str)).flatmap(lambda cls: st.tuples(st.just(cls), pairs(cls, SIDES[cls]))),
)
def test_two_arms_are_made_of_any_mapping_or_refused(directory, data):
    cls, mapping = data
    make(cls, TWO[cls], mapping, directory)
