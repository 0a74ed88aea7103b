"""The backend, as Commander uses it: conformance.py passes for both contracts, and finds the faults that are seeded.

The default tier runs what needs no motion, and the start of a page. Stops, jogs, refusals and the gripper have quicker
tests in lock-step beside this file.
"""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from tests.support.paths import ROOT

SEEDS = ROOT / "tests" / "waldo" / "seeds"
OTHER_ULTRA, BIG = ("yam_ultra_2", "flexible_4310"), ("big_yam", "no_gripper")


def conformance(*options, seed=None, **variables):
    """(exit status, lines) of a run."""
    environment = {**os.environ, **variables}
    if seed is not None:
        environment |= {"PYTHONPATH": str(SEEDS), "YAM_SEED": seed}
    command = [sys.executable, "tests/waldo/conformance.py", "lerobot_robot_yam.waldo.robot:Robot", "--quiet", *options]
    # Not stderr: an orphaned controller would keep a pipe open.
    run = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)
    return run.returncode, run.stdout.splitlines()


@pytest.fixture
def no_orphans():
    """Ends what a seeded fault has left running."""
    yield
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # it ended meanwhile, or is somebody else's
            if b"YAM_SEED=orphaned_controller\0" in path.read_bytes():
                os.kill(int(path.parent.name), signal.SIGTERM)


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


@pytest.mark.long
@pytest.mark.parametrize(
    "seed, found, only, sections",
    [
        ("constructor_without_kwargs", "constructor takes Commander's arguments", "static", ""),
        ("lower_case_tool_key", "tool keys are unique, UPPER CASE", "static", ""),
        ("io_of_five", "every status fits Commander's buffers", "live", "boot"),
        ("metres_in_pose", "pose = fk(angles), translation in mm", "live", "page"),
        ("resume_replays_a_cancelled_move", "after a stop moves nothing", "live", "stopping"),
        ("jog_without_expiry", "stands still within", "live", "motion"),
        ("nan_jog", "jog_j NaN speed", "live", "refusals"),
        ("inverted_gripper", "(0 open, 1 closed)", "live", "tools_live"),
        ("served_on_every_address", "serves on loopback only", "live", "boot"),
        ("orphaned_controller", "ends within 10 s of its parent's kill", "live", "end"),
    ],
)
def test_a_seeded_fault_is_found(no_orphans, seed, found, only, sections):
    status, lines = conformance("--contract", "B", "--only", only, "--sections", sections, seed=seed)
    assert status == 1 and any(found in line for line in failed(lines)), lines
