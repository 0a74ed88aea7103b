"""The backend, as Commander uses it: conformance.py passes for both contracts.

The default tier runs what needs no motion, and the start of a page. Stops, jogs, refusals and the gripper have quicker
tests in lock-step beside this file.
"""

import os
import subprocess
import sys

import pytest

from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from tests.support.paths import ROOT

OTHER_ULTRA, BIG = ("yam_ultra_2", "flexible_4310"), ("big_yam", "no_gripper")


def conformance(*options, **variables):
    """(exit status, lines) of a run."""
    command = [sys.executable, "tests/waldo/conformance.py", "lerobot_robot_yam.waldo.robot:Robot", "--quiet", *options]
    # Not stderr: an orphaned controller would keep a pipe open.
    run = subprocess.run(command, cwd=ROOT, env={**os.environ, **variables}, stdout=subprocess.PIPE, text=True)
    return run.returncode, run.stdout.splitlines()


def failed(lines):
    return [line for line in lines if line.startswith("FAIL")]


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(["--only", "static,dry"], id="static,dry"),
        pytest.param(["--contract", "C", "--only", "live", "--sections", "boot"], id="boot", marks=pytest.mark.long),
        pytest.param([], id="all", marks=pytest.mark.long),
    ],
)
def test_the_backend_meets_the_contract(options):
    status, lines = conformance(*options)
    assert not failed(lines) and status == 0, lines


@pytest.mark.long
@pytest.mark.parametrize("gripper", GRIPPERS)
@pytest.mark.parametrize("arm", ARMS)
def test_every_arm_with_every_gripper_meets_both_contracts(arm, gripper):
    _, lines = conformance("--only", "static,dry", YAM_WALDO_ARM=arm, YAM_WALDO_GRIPPER=gripper)
    assert not failed(lines) and len([line for line in lines if "passed, 0 failed" in line]) == 2, lines


@pytest.mark.long
@pytest.mark.parametrize("arm, gripper", [("yam_pro", "crank_4310"), ("yam_ultra", "linear_3507"), OTHER_ULTRA, BIG])
def test_the_other_arms_meet_the_contract_live(arm, gripper):
    status, lines = conformance("--contract", "C", "--only", "live", YAM_WALDO_ARM=arm, YAM_WALDO_GRIPPER=gripper)
    assert not failed(lines) and status == 0, lines
