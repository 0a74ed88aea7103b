"""Calls of yam-motors as the tests make them, on a rig with one arm."""

import json

from lerobot_robot_yam.commands.motors import main
from tests.support.crooked_arm import arguments


def run(rig, action, *more):
    return main([action, *map(str, more), *arguments(rig)])


def read(rig, capsys, *more):
    capsys.readouterr()
    assert run(rig, "read", *more, "--json") == 0
    return json.loads(capsys.readouterr().out)["motors"]


def value(rig, capsys, motor, name):
    ((registers),) = read(rig, capsys, name, "--motor", motor).values()
    return registers[name]


def cycle(rig, motor=None):
    """Switch the power off and on."""
    rig.fault("only", motor, "power", False)
    rig.fault("only", motor, "power", True)


def writes(rig):
    return {name: motor["flash_writes"] for name, motor in rig.state()["arms"]["only"]["motors"].items()}


def refused(rig, capsys, *arguments):
    """What it says; no motor was written to or stored."""
    capsys.readouterr()
    assert run(rig, *arguments) == 1
    assert not any(writes(rig).values())
    return capsys.readouterr().err
