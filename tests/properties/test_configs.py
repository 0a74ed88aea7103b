"""Any configuration is usable or refused by name: files, overrides, and the fields of an arm."""

import dataclasses
import json
import math

import numpy as np
import pytest
import yaml
from hypothesis import strategies as st

from lerobot_robot_yam.arm import profile_files as profiles
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.arm.profile_files import (
    ARMS,
    GRIPPERS,
    NO_ARM,
    check_arm,
    check_gripper,
    load_arm,
    load_gripper,
)
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene import scene as scenes
from lerobot_robot_yam.rig.scene.scene import Options, load_scene
from lerobot_robot_yam.system.runtime_files import rig_name
from lerobot_robot_yam.system.strict_yaml import parse, read_yaml
from tests.support.cases import documents, finite, for_all, junk, mutations, numbers, workspaces

pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value", "ignore:Inertia matrix")

HINTS = ["!!int x", "!!bool x", "!!timestamp x", "2020-13-45", "0b_", "&x [*x]", "!!set {a}", "1e-3", ".nan", "[[[["]


@for_all(text=st.text(max_size=40) | st.sampled_from(HINTS).map(lambda value: f"a: {value}") | st.binary(max_size=20))
def test_a_file_holds_a_mapping_or_is_refused(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode(errors="surrogatepass"))
    for read in (read_yaml, load_arm, load_gripper, load_scene):
        try:
            document = read(path)
        except ConfigError as error:
            assert "any" in str(error)
        else:
            assert read is read_yaml and isinstance(document, dict)


# mutated files

ARM_FILE = read_yaml(profiles.PROFILES / "arms" / "yam.yaml")
GRIPPER_FILE = read_yaml(profiles.PROFILES / "grippers" / "linear_4310.yaml")
SCENE_FILE = read_yaml(scenes._DIRECTORY / "bimanual_table.yaml")


@for_all(short=60, document=mutations(ARM_FILE))
def test_a_mutated_arm_is_usable_or_refused(document):
    try:
        arm = parse(ArmProfile, document, "arm 'mine'")
        check_arm(arm, "arm 'mine'")
        torque = GravityModel(arm, "linear_4310").torque(np.zeros(arm.joint_count))
    except ConfigError as error:
        assert str(error)
        return
    assert torque.shape == (arm.joint_count,) and np.isfinite(torque).all()
    assert {motor.direction for motor in arm.motors} <= {-1, 1}
    assert (arm.speed_limit_rad_s > 0).all()
    assert (arm.joint_limits_rad[:, 0] < arm.joint_limits_rad[:, 1]).all()


@for_all(short=60, document=mutations(GRIPPER_FILE))
def test_a_mutated_gripper_is_usable_or_refused(document):
    try:
        gripper = parse(GripperProfile, document, "gripper 'mine'")
        check_gripper(gripper, "gripper 'mine'")
        torque = GravityModel("yam", gripper).torque(np.zeros(6))
    except ConfigError as error:
        assert str(error)
        return
    assert np.isfinite(torque).all()
    if gripper.motor is not None:
        assert gripper.stroke_rad > 0.0 and gripper.calibration.torque_nm > 0.0


@for_all(short=50, document=mutations(SCENE_FILE))
def test_a_mutated_scene_is_usable_or_refused(tmp_path_factory, document):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    try:
        path.write_text(json.dumps(document, default=str))
    except TypeError:  # keys that JSON does not have
        path.write_text(yaml.safe_dump(document))
    try:
        scene = load_scene(path)
    except ConfigError as error:
        assert str(error)
        return
    assert len(set(scene.channels)) == len(scene.arms)
    assert scene.options.timestep_s > 0.0


OPTIONS = [field.name for field in dataclasses.fields(Options)]


@for_all(
    short=50,
    options=st.dictionaries(
        st.sampled_from([*OPTIONS, "frictoin"]),
        st.one_of(numbers(), junk(), st.sampled_from([["follower_left"], "leader_left", "big_yam", "limp"])),
        max_size=3,
    ),
)
def test_options_of_a_scene_are_taken_or_refused(options):
    try:
        scene = load_scene(options=options)
    except ConfigError as error:
        assert str(error)
        return
    for key, value in options.items():
        held = getattr(scene.options, key)
        if isinstance(held, float):
            assert math.isfinite(held) and held == float(value)


@for_all(
    rig=junk() | numbers() | st.sampled_from(["auto", "auto:12", "auto-12", "auto:²", "auto:" + "9" * 60, "x" * 99])
)
def test_a_rigs_name_is_resolved_or_refused(rig):
    try:
        name, owner = rig_name(rig)
    except ConfigError:
        return
    assert isinstance(name, str) and 0 < len(name) < 80 and (owner is None or owner >= 0)


# the fields of an arm

SIX = ("kp", "kd", "gravity_factor", "coulomb_friction_nm", "idle_kd", "torque_limit_nm", "speed_limit_rad_s")
FIELDS = [field.name for field in dataclasses.fields(ArmConfig)]


@st.composite
def fields(draw):
    """Keywords of `ArmConfig`, a few of them changed to something that is right, nearly right or quite wrong."""
    values = {"channel": "can0", "name": "left"}
    for key in draw(st.lists(st.sampled_from(FIELDS), max_size=3, unique=True)):
        vector = st.lists(numbers() | st.floats(0, 4), min_size=5, max_size=7) | st.lists(
            st.floats(0.01, 4), min_size=6, max_size=6
        )
        choices = [numbers(), junk(), documents(), st.floats(0, 20), finite()]
        if key in SIX:
            choices += [vector, vector.map(tuple), st.lists(st.floats(0, 9), min_size=6, max_size=6).map(np.array)]
        elif key == "ee_inertia":
            choices.append(st.lists(st.floats(-1, 1) | st.floats(0.01, 1), min_size=9, max_size=10))
        elif key in ("payload_com_m", "gripper_stops_rad"):
            choices.append(st.lists(numbers(), min_size=2, max_size=3))
        elif key == "workspace":
            choices = [workspaces(), junk()]
        elif key in ("arm", "gripper"):
            choices.append(st.sampled_from([*ARMS, *GRIPPERS, NO_ARM, "nowhere.yaml", "\0.yaml", "x" * 5000 + ".yaml"]))
        values[key] = draw(st.one_of(choices))
    return values


@for_all(values=fields())
def test_any_fields_make_an_arm_or_are_refused(values):
    try:
        config = ArmConfig(**values)
        hardware = ResolvedArm(config)
    except ConfigError as error:
        assert str(error)
        return
    assert ArmConfig(**json.loads(json.dumps(dataclasses.asdict(config)))) == config  # as it travels to the loop
    n = hardware.n
    for name in ("direction", "kp", "kd", "idle_kd", "torque_limit_nm", "lower", "upper", "speed_limit"):
        array = getattr(hardware, name)
        assert array.shape == (n,) and np.isfinite(array).all(), name
    assert (hardware.kp >= 0).all() and (hardware.speed_limit > 0).all() and (hardware.lower < hardware.upper).all()
    assert len({motor.can_id for motor in hardware.motors}) == n
    assert 0.0 <= config.rate_hz <= 1000.0
    for limit in (config.command_timeout_s, config.max_state_age_s):
        assert math.isfinite(limit) and limit > 0.0
    assert config.max_relative_target is None or config.max_relative_target > 0.0
