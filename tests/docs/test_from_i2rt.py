"""docs/from-i2rt.md: what stands in its right cells runs on the rig, row by row."""

import contextlib
import re

import numpy as np
import pytest

import lerobot_robot_yam
from lerobot_robot_yam.session.yam_arm import YamArm
from tests.mobile.rails import Rail
from tests.support.pages import blocks, section
from tests.support.paths import ROOT
from tests.support.rigged import rig_of, sim_config

PAGE = "docs/from-i2rt.md"


def rows(of="Calls"):
    """(vendor's call, our code) of each row."""
    lines = [line for line in section(PAGE, of).splitlines() if line.startswith("| ") and "`" in line]
    cells = [line.strip("| ").split(" | ") for line in lines]
    return [(left, re.findall(r"`([^`]+)`", right)[-1]) for left, right in cells]


def test_every_row_of_the_table_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with rig_of("lockstep", arms=["follower_left"]) as rig:

        def on_rig(channel, gripper):
            assert channel == "can0"
            return YamArm(sim_config(rig, "follower_left", gripper=gripper), isolation="lockstep")

        (imports,) = blocks((ROOT / PAGE).read_text(), "python")
        names = {}
        exec(imports, names)
        assert names["YamArm"] is lerobot_robot_yam.YamArm
        names["YamArm"] = on_rig
        for left, code in rows():
            try:
                exec(code, names)
            except Exception as error:
                pytest.fail(f"{left}: {code}: {error!r}")
        assert not names["arm"].connected
    assert np.load("states.npz")["q"].shape[1] == 7


def test_every_row_of_the_base_runs(tmp_path):
    lift = Rail(tmp_path, height_m=0.1, stroke_m=0.3, known=False)
    with contextlib.closing(lift.rig):

        def on_rig(channel, rail):
            assert channel == "can0" and rail == {"io": "gpio"}
            return lift.base()

        names = {"YamBase": on_rig}
        for left, code in rows("Mobile base"):
            try:
                exec(code, names)
            except Exception as error:
                pytest.fail(f"{left}: {code}: {error!r}")
        assert not any(motor["enabled"] for motor in lift.rig.state()["base"]["motors"].values())
    said = " ".join(left for left, _ in rows("Mobile base"))
    for call in "get_odometry reset_odometry set_target_velocity get_wheel_states get_linear_rail_state".split():
        assert call in said


def test_the_table_speaks_of_every_call_of_the_vendor():
    said = " ".join(left for left, _ in rows())
    for call in (
        "get_yam_robot num_dofs get_joint_pos get_joint_state get_observations get_robot_info move_joints close"
        " command_joint_pos command_joint_state update_kp_kd enter_gravity_comp_idle zero_torque_mode start_recording"
        " stop_recording"
    ).split():
        assert call in said
