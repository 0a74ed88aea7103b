"""docs/first-hour.md: its transcript is played, from unnamed adapters to a recorded episode of two arms.

The virtual rig is the arms, a directory the computer, and this test udev and the person's hands.
"""

import os
import re
import shlex
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.rig.control import running_rig
from tests.support.paths import ROOT
from tests.support.system_tree import USER, SystemTree
from tests.support.terminal import Terminal
from tests.support.transcript import Play, commands_of, lines_of
from tests.support.unnamed_rig import SHUFFLED, write_scene

PAGE = "docs/first-hour.md"
RULES = "etc/udev/rules.d/70-yam-can.rules"
NAMES = {arm: f"can_{arm.replace('left', 'l').replace('right', 'r')}" for arm in SHUFFLED}
SVG = "{http://www.w3.org/2000/svg}"
SIDES = ("left", "right")
UNZEROED = 0.3  # share of its travel at which a released trigger of the factory is taken to be
FIRST = "yam-setup-can"
REACH = [0.3, 1.0, 0.9, -0.3, 0.2, 0.3]


def start(command, directory, *, rig, root, cwd):
    """Run a command of the page on the rig and the tree that stand for arms and computer."""
    words = shlex.split(re.sub(r'sudo "\$\(which ([\w-]+)\)"', r"\1", command))
    more = {"yam-setup-can": [f"--root={root}", f"--rig={rig.name}", f"--user={USER}"]}
    more["yam-setup"] = [f"--root={root}", f"--rig={rig.name}"]
    environment = {"HF_LEROBOT_CALIBRATION": str(cwd / "cal"), "XDG_STATE_HOME": str(cwd / "state"), "COLUMNS": "200"}
    program = Path(sys.executable).with_name(words[0])
    return Terminal(directory, program, *words[1:], *more.get(words[0], []), cwd=cwd, env=os.environ | environment)


def turn_wrist(rig, channel):
    q = rig.state()["arms"][channel]["q"]
    rig.lift(channel, [*q[:-1], q[-1] + 0.8], then_release=True)


def plug_in_again(tree):
    """What udev does with the rules that were written: adapters get their names. Returns them by the old ones."""
    by_serial = {}
    for line in tree.read(RULES).splitlines():
        if match := re.search(r'ATTRS\{serial\}=="(\w+)".*NAME="(\w+)"', line):
            by_serial[match[1]] = match[2]
    names = {}
    for port, channel in enumerate(sorted(SHUFFLED.values()), 1):
        serial = f"0031{channel.upper()}"
        tree.sysfs.unplug(f"1-{port}")
        tree.sysfs.adapter(by_serial[serial], f"1-{port}", serial=serial)
        names[channel] = by_serial[serial]
    return names


def test_it_is_few_commands_and_each_is_told_of_in_docs():
    programs = [command.replace('sudo "$(which ', "").split()[0].rstrip(')"') for command in commands_of(PAGE)]
    assert len(programs) <= 10 and programs[0] == FIRST and programs[-1] == "lerobot-record"


def test_the_drawing_has_the_names_and_nothing_lies_outside():
    root = ElementTree.parse(ROOT / "docs/wiring.svg").getroot()
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    texts = root.findall(".//{*}text")
    assert set(NAMES.values()) <= {text.text for text in texts}
    assert all(0 < float(t.attrib["x"]) < width and 12 < float(t.attrib["y"]) < height for t in texts)
    boxes = [
        [float(box.attrib.get(key, 0)) for key in ("x", "y", "width", "height")] for box in root.iter(f"{SVG}rect")
    ]
    assert all(x + w <= width and y + h <= height for x, y, w, h in boxes)
    for index, (x, y, w, h) in enumerate(boxes[1:], 1):  # the first is the paper
        for x2, y2, w2, h2 in boxes[index + 1 :]:
            assert x + w <= x2 or x2 + w2 <= x or y + h <= y2 or y2 + h2 <= y


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.timeout(1200)
def test_the_first_hour_ends_with_an_episode(tmp_path):
    tree = SystemTree(tmp_path / "root", "ubuntu")
    for port, channel in enumerate(sorted(SHUFFLED.values()), 1):
        tree.sysfs.adapter(channel, f"1-{port}", serial=f"0031{channel.upper()}")
    desk = tmp_path / "desk"
    desk.mkdir()
    (desk / "configs").symlink_to(ROOT / "configs")
    lines = lines_of(PAGE)
    second = next(i for i, line in enumerate(lines) if line.startswith("$ ") and FIRST not in line)

    def play(rig, lines, actions):
        directory = tmp_path / rig.name
        directory.mkdir()
        Play(directory, lambda *words: start(*words, rig=rig, root=tree.root, cwd=desk), actions).run(lines)

    with running_rig(scene=write_scene(tmp_path / "unnamed.yaml")) as rig:
        wrists = {
            f"you turn the wrist of the {side} {role}": lambda c=SHUFFLED[f"{role}_{side}"]: turn_wrist(rig, c)
            for side in SIDES
            for role in ("follower", "leader")
        }
        play(rig, lines[:second], wrists)
        assert not [event for event in rig.events() if event["kind"] == "motor_enabled"]
    assert plug_in_again(tree) == {SHUFFLED[arm]: name for arm, name in NAMES.items()}

    with running_rig(scene=write_scene(tmp_path / "named.yaml", NAMES)) as rig:
        for name in NAMES.values():
            for motor in rig.state()["arms"][name]["motors"]:
                rig.fault(name, motor, "register", 0, register=int(Register.TIMEOUT))
        for side in SIDES:
            rig.trigger(NAMES[f"leader_{side}"], UNZEROED)

        def move():
            for side in SIDES:
                rig.lift(NAMES[f"leader_{side}"], REACH, 2.0, trigger=UNZEROED, then_release=True)

        play(rig, lines[second:], {"you move both leaders": move})
        motors = [motor for arm in rig.state()["arms"].values() for motor in arm["motors"].values()]
        assert not any(motor["enabled"] for motor in motors)

    robot = yaml.safe_load((desk / "rig.yaml").read_text())["robot"]
    data = LeRobotDataset("local/first", root=desk / "data/first")
    assert data.num_episodes == 1 and set(data.meta.video_keys) == {
        f"observation.images.{name}" for name in robot["cameras"]
    }
    actions = np.array(data.hf_dataset["action"])
    states = np.array(data.hf_dataset["observation.state"])
    assert actions.shape[1] == states.shape[1] == 14
    for arm in (0, 7):  # both arms were led to where the hands went
        assert np.ptp(actions[:, arm + 1]) > 0.8 and np.ptp(states[:, arm + 1]) > 0.6
