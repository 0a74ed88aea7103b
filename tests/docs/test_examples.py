"""The programs of examples/, as they stand, on a virtual rig: they end well, print what they promise and land."""

import ast
import os
import re
import subprocess
import sys

import pytest

from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.scene.scene import load_scene
from tests.support.paths import ROOT

EXAMPLES = sorted(ROOT.glob("examples/*.py"))
MOST_LINES = 60


def run(name, rig=None):
    """What the example prints; it uses that rig, or starts its own."""
    environment = os.environ | ({} if rig is None else {"YAM_RIG": rig.name})
    command = [sys.executable, f"examples/{name}.py"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def landed(rig):
    """Whether motors of the rig were energised and none is now."""
    kinds = {event["kind"] for event in rig.events()}
    arms = rig.state()["arms"].values()
    return "motor_enabled" in kinds and not any(m["enabled"] for arm in arms for m in arm["motors"].values())


def numbers(line):
    return [float(number) for number in re.findall(r"-?\d+\.\d*", line)]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_short_and_begin_with_their_command(path):
    text = path.read_text()
    assert len(text.splitlines()) < MOST_LINES
    assert ast.get_docstring(ast.parse(text)).startswith(f"python examples/{path.name}\n\n")


def test_each_example_is_run_here():
    here = (ROOT / "tests" / "docs" / "test_examples.py").read_text()
    assert {path.stem for path in EXAMPLES} == set(re.findall(r'run\("(\w+)"', here))


@pytest.mark.long
def test_one_arm_is_read_and_moved():
    with running_rig(arms=["follower_left"]) as rig:
        printed = run("read_and_move", rig).splitlines()
        assert landed(rig)
    assert numbers(printed[1]) == pytest.approx([0, 1, 1, 0, 0, 0, 1], abs=0.05)
    assert numbers(printed[3]) == pytest.approx([0], abs=0.05) and printed[-1] == "landed"


@pytest.mark.long
def test_two_arms_move_in_step():
    with running_rig(arms=["follower_left", "follower_right"]) as rig:
        printed = run("two_arms", rig)
        assert landed(rig)
    (apart,) = numbers(printed)
    assert apart < 0.03 and printed.endswith("landed\n")


@pytest.mark.long
def test_a_block_is_pushed_in_a_scene_of_ones_own():
    assert load_scene(ROOT / "examples" / "push_the_block.yaml").tasks[0].name == "push"
    printed = run("custom_scene")
    assert "\nsuccess after" in printed and printed.endswith("landed\n")


@pytest.mark.long
def test_a_policy_drives_lerobots_robot():
    with running_rig(arms=["follower_left"]) as rig:
        printed = run("policy", rig).splitlines()
        assert landed(rig)
    reached = [0, 1, 1, 0, 0, 0, 0.5]
    assert list(ast.literal_eval(printed[0]).values()) == pytest.approx(reached, abs=0.05) and printed[1] == "landed"
