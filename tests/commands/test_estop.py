"""Stopping all arms from a command line: whom it reaches, who is said to hear it, what cannot be done."""

import json
import os
import subprocess
import sys

import pytest

from lerobot_robot_yam.commands.estop import main
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system import runtime_dirs
from lerobot_robot_yam.system.runtime_files import FileLock, runtime_dir
from tests.state.test_emergency_stop import wait_mode
from tests.support.paths import ROOT
from tests.support.rigged import sim_config
from tests.support.tiers import spread

UID = os.getuid()


def answer(capsys, *arguments):
    status = main([*arguments, "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_latch_status_release(capsys):
    assert main(["status"]) == 0
    assert main(["--why", "a test"]) == 0
    assert EmergencyStop().latched and "a test" in EmergencyStop().reason()
    assert main(["status"]) == 1
    capsys.readouterr()
    status, said = answer(capsys, "status")
    assert status == 1 and said["latched"] and "a test" in said["reason"]
    main(["--why", "later"])
    assert "a test" in EmergencyStop().reason()  # the first reason stands
    assert main(["release"]) == 0
    assert not EmergencyStop().latched
    assert main(["release"]) == 0


def test_stops_add_up_and_each_is_released_by_its_name(capsys):
    stop = EmergencyStop()
    try:
        stop.latch("a button of the handle", "leader_left")
        assert main(["--why", "a test"]) == 0
        assert main(["status"]) == 1
        lines = capsys.readouterr().out.splitlines()[-3:-1]
        assert lines[0].startswith("emergency stop latched by leader_left: a button of the handle (process ")
        assert lines[1].startswith("emergency stop latched by yam-estop: a test (process ")
        assert main(["release"]) == 1  # its own only
        said = capsys.readouterr().out
        assert "released; it was latched by yam-estop" in said and stop.names() == ["leader_left"]
        assert "STILL latched by leader_left" in said and "yam-estop release leader_left" in said
        assert main(["release", "nobody"]) == 1 and main(["release"]) == 1 and stop.latched
        assert main(["release", "leader_left"]) == 0 and not stop.latched
        stop.latch("one", "one")
        main([])
        assert main(["release", "--all"]) == 0 and not stop.latched
    finally:
        stop.release()


def test_nothing_is_loaded_before_it_is_latched(tmp_path):
    """What `yam-estop` runs, as it is installed for a clone. Python's start is all that takes long in it."""
    scripts, packages = tmp_path / "bin", tmp_path / "lib" / "python3.99" / "site-packages"
    scripts.mkdir()
    packages.mkdir(parents=True)
    (packages / "_editable_impl_lerobot_robot_yam.pth").write_text(str(ROOT))
    script = (ROOT / "lerobot_robot_yam/commands/yam-estop.sh").read_text()
    told = script.replace("sys.exit(main())", "status = main()\nprint(*sys.modules)\nsys.exit(status)")
    for name, text in (("yam-estop", script), ("told", told), ("python", f'#!/bin/sh\nexec {sys.executable} "$@"')):
        (scripts / name).write_text(text)
        (scripts / name).chmod(0o755)
    (tmp_path / "link").symlink_to(scripts / "yam-estop")
    try:
        loaded = subprocess.run([scripts / "told"], capture_output=True, text=True, check=True).stdout.split()
        assert EmergencyStop().latched and "lerobot_robot_yam.commands.estop" in loaded
        assert not {"site", "re", "json", "pathlib", "logging", "argparse", "typing", "wrapt"} & set(loaded)
        assert subprocess.run([tmp_path / "link", "release"], capture_output=True).returncode == 0
        assert not EmergencyStop().latched
        elsewhere = subprocess.run([scripts / "yam-estop", "--host=?"], capture_output=True, text=True)
        assert "write NAME or ADDRESS" in elsewhere.stderr
    finally:
        EmergencyStop().release()


def test_it_says_that_nobody_hears_it_and_latches_all_the_same(capsys):
    try:
        assert main([]) == 0
        said = capsys.readouterr().out
        assert "emergency stop latched" in said and "NO SESSION RUNS HERE THAT HEARS IT" in said
        assert answer(capsys)[1]["heard_by"] == []
        with FileLock(runtime_dir() / "lock-can9", "can9"):  # who only asks the motors
            assert answer(capsys)[1]["heard_by"] == []
    finally:
        main(["release"])


def test_it_says_which_sessions_hear_it(capsys, rig):
    session = ArmSession([sim_config(rig, "follower_left")])
    session.start()
    try:
        assert main([]) == 0
        said = capsys.readouterr().out
        assert f"heard by {rig.name}.follower_left (process " in said and "NO SESSION" not in said
        wait_mode(session, "follower_left", Mode.STOPPED)
        (one,) = answer(capsys, "status")[1]["heard_by"]
        assert (one["channel"], one["directory"]) == (f"{rig.name}.follower_left", str(runtime_dir()))
        assert os.path.exists(f"/proc/{one['process']}")
        assert main(["release"]) == 0
        released, driven = capsys.readouterr().out.splitlines()
        assert released.startswith("emergency stop released; it was latched by yam-estop: yam-estop (process ")
        assert driven.startswith(f"driven: {rig.name}.follower_left (process ") and "ended ones land" in driven
    finally:
        main(["release"])
        session.stop()


@pytest.fixture
def shared(monkeypatch, tmp_path):
    """Two places for everybody's directories; a user has one in the first, root's command finds the second's too."""
    monkeypatch.delenv("YAM_RUNTIME_DIR")
    places = (tmp_path / "first", tmp_path / "second")
    for place in places:
        place.mkdir()
    monkeypatch.setattr(runtime_dirs, "_SHARED", tuple(map(str, places)))
    return places


def test_it_reaches_every_directory_that_it_may_write(shared, capsys):
    own, other = (place / f"yam-{UID}" for place in shared)
    own.mkdir()
    other.mkdir()
    (other / "state-can_other").touch()
    with FileLock(other / "lock-can_other", "can_other"):
        assert main(["--why", "a test"]) == 0
        assert f"heard by can_other (process {os.getpid()})" in capsys.readouterr().out
        for directory in (own, other):
            assert "a test" in EmergencyStop(directory).reason()
        assert main(["status"]) == 1
        said = capsys.readouterr().out
        assert f"latched in {own} by yam-estop: a test" in said and f"latched in {other} by yam-estop: a test" in said
        assert main(["release"]) == 0
        assert "NO SESSION" not in capsys.readouterr().out
    assert not EmergencyStop(own).latched and not EmergencyStop(other).latched


def test_links_and_directories_of_others_are_left_alone(shared, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (shared[1] / f"yam-{UID}").symlink_to(elsewhere)
    strangers = [shared[1] / f"yam-{UID + 1}", shared[1] / "yam-data"]
    for stranger in strangers:
        stranger.mkdir()
    assert main([]) == 0
    assert not any(list(directory.iterdir()) for directory in (elsewhere, *strangers))


@pytest.mark.skipif(UID != 0, reason="only root reaches the directories of others")
def test_root_who_drives_nothing_leaves_nothing(shared):
    """Everybody else would be told for ever that they cannot stop root's arms."""
    somebodys = shared[0] / "yam-4242"
    somebodys.mkdir()
    os.chown(somebodys, 4242, -1)
    assert main([]) == 0
    assert EmergencyStop(somebodys).latched and list(shared[0].iterdir()) == [somebodys]
    assert main(["release"]) == 0
    assert not EmergencyStop(somebodys).latched


def test_it_says_whom_it_could_not_stop(shared, capsys, tmp_path):
    own, other = (place / f"yam-{UID}" for place in shared)
    own.mkdir()
    other.mkdir()
    (other / "emergency-stop").symlink_to(tmp_path / "written")  # through which root would write where it is told
    assert main([]) == 1
    said = capsys.readouterr()
    assert f"NOT STOPPED: arms that are driven by way of {other}" in said.err and "sudo" in said.err
    assert EmergencyStop(own).latched and "emergency stop latched" in said.out
    assert not (tmp_path / "written").exists()
    assert answer(capsys)[1]["missed"].keys() == {str(other)}


def test_a_stop_that_nobody_hears_of_is_an_error(capsys, monkeypatch):
    monkeypatch.setenv("YAM_RUNTIME_DIR", "/dev/null/gone")
    assert main([]) == 1
    said = capsys.readouterr()
    assert "NOTHING IS STOPPED" in said.err and not said.out
    status, said = answer(capsys)
    assert status == 1 and not said["latched"] and "/dev/null/gone" in said["missed"]


STOPPED_ON_A_FULL_DISK = """
import errno, sys
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.commands.estop import main
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.rigged import rig_of, session_on, sim_config
full = sys.argv[1]
with rig_of("lockstep", arms=["follower_left"]) as rig:
    session = session_on(rig, sim_config(rig, "follower_left"))
    session.start()
    def is_soon(mode):
        session.clock.sleep(0.1)
        return session["follower_left"].mode() is mode
    try:
        for number in range(1000):
            with open(runtime_dir() / f"filler-{number}", "wb") as file:
                file.write(bytes(4096 * (full == "no room")))
    except OSError as error:
        assert error.errno == errno.ENOSPC
    else:
        raise AssertionError("it is not full")
    for _ in range(2):
        assert is_soon(Mode.HOLD)
        assert main([]) == 0 and is_soon(Mode.STOPPED)
        assert main(["status"]) == 1
        assert main(["release", "--all"]) == 0
    session.discard()
"""


@pytest.mark.parametrize("full", spread(["no file", "no room"], 0))
def test_it_stops_arms_on_a_disk_that_is_full(full, tmp_path):
    """A small disk of its own, in a name space of its own."""
    mount = 'mount -t tmpfs -o size=256k,nr_inodes="$FILES",mode=700 none "$YAM_RUNTIME_DIR" && exec "$@"'
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", mount, "sh", sys.executable, "-c"]
    if subprocess.run(command[:3] + ["true"], capture_output=True).returncode:
        pytest.skip("this machine lets nobody mount a small disk for a test")
    files = {"no file": "40", "no room": "400"}[full]
    environment = {**os.environ, "YAM_RUNTIME_DIR": str(tmp_path), "FILES": files}
    done = subprocess.run(
        [*command, STOPPED_ON_A_FULL_DISK, full], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("emergency stop latched") == 4
