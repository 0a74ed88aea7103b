"""A rig ends with its last client, however that ends, and leaves nothing."""

import os
import signal
import subprocess
import sys
import time

import can
import pytest

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.client import launch, rig_control
from lerobot_robot_yam.rig.client.rig_control import RigControl, runs, wait_ended
from lerobot_robot_yam.rig.server import lifetime
from lerobot_robot_yam.system.runtime_files import FileLock, rig_name, runtime_dir

CLIENT = """
import can, os, sys, time
bus = can.Bus(interface="yam_sim", channel="leader_left", rig={rig!r})
from lerobot_robot_yam.rig.client.rig_control import RigControl
print(RigControl(bus.rig, hold=False).pid, bus.rig, flush=True)
time.sleep(60)
"""


def files_of(name):
    return sorted(path.name for path in runtime_dir().glob(f"rig-{name}.*"))


def wait_dead(pid, timeout_s=15.0):
    deadline = time.monotonic() + timeout_s
    while runs(pid):
        assert time.monotonic() < deadline, f"process {pid} still runs"
        time.sleep(0.02)


def start_client(rig):
    process = subprocess.Popen([sys.executable, "-c", CLIENT.format(rig=rig)], stdout=subprocess.PIPE, text=True)
    pid, name = process.stdout.readline().split()
    return process, int(pid), name


def test_it_ends_after_its_last_client_and_leaves_no_file():
    rig = RigControl.start()
    bus = can.Bus(interface="yam_sim", channel="leader_left", rig=rig.name)
    assert {path.rpartition(".")[2] for path in files_of(rig.name)} == {"sock", "world", "links", "scene", "log"}
    rig.close()
    time.sleep(1.5)
    bus.send(can.Message(arbitration_id=0x7FF, data=(1, 0, 0xCC, 0, 0, 0, 0, 0), is_extended_id=False))
    assert bus.recv(5.0) is not None  # still there for the bus
    bus.shutdown()
    wait_ended(rig)
    assert files_of(rig.name) == []


def test_a_quick_return_finds_the_same_rig():
    with RigControl.start() as first:
        pass
    with RigControl(first.name) as second:
        assert second.pid == first.pid
    wait_ended(second)


@pytest.mark.parametrize("rig", ["test-killed", "auto"])
def test_a_killed_client_ends_it_too(rig):
    process, pid, name = start_client(rig)
    assert runs(pid)
    process.kill()
    process.wait()
    process.stdout.close()
    wait_dead(pid)
    assert files_of(name) == []


def test_a_watcher_does_not_keep_it():
    with RigControl.start() as rig:
        watcher = RigControl(rig.name, hold=False)
    wait_ended(rig)
    with pytest.raises(RigError, match="ended"):
        watcher.state()
    watcher.close()


def test_sigterm_ends_it_cleanly():
    rig = RigControl.start()
    os.kill(rig.pid, signal.SIGTERM)
    wait_ended(rig)
    assert files_of(rig.name) == []
    rig.close()


def test_a_killed_rig_is_replaced():
    rig = RigControl.start(name="test-replaced")
    os.kill(rig.pid, signal.SIGKILL)
    wait_ended(rig)
    rig.close()
    with RigControl("test-replaced") as again:
        assert again.pid != rig.pid
        assert again.state()["sim_s"] >= 0
    wait_ended(again)
    assert files_of("test-replaced") == []


def test_clients_that_start_at_once_share_one_rig():
    clients = [
        subprocess.Popen([sys.executable, "-c", CLIENT.format(rig="test-race")], stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    pids = {client.stdout.readline().split()[0] for client in clients}
    for client in clients:
        client.kill()
        client.wait()
        client.stdout.close()
    assert len(pids) == 1
    wait_dead(int(pids.pop()))
    assert files_of("test-race") == []


def test_rigs_side_by_side_do_not_meet():
    with RigControl.start() as one, RigControl.start() as other:
        one.place("cube", (0.6, 0, 0.02))
        assert one.pid != other.pid
        assert other.state()["props"]["cube"]["pos"][0] != pytest.approx(0.6, abs=0.05)
    wait_ended(one)
    wait_ended(other)


def test_a_stopped_rig_is_reported_not_waited_for(monkeypatch):
    rig = RigControl.start()
    monkeypatch.setattr(launch, "_HELLO_TIMEOUT_S", 0.3)
    os.kill(rig.pid, signal.SIGSTOP)
    try:
        with pytest.raises(RigError, match="does not answer"):
            RigControl(rig.name)
    finally:
        os.kill(rig.pid, signal.SIGCONT)
    rig.close()
    wait_ended(rig)


def test_files_of_a_dead_owner_are_swept_at_the_next_start():
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left = [runtime_dir() / f"rig-auto-{dead.pid}.{suffix}" for suffix in ("sock", "world", "log")]
    for path in left:
        path.touch()
    with RigControl.start() as rig:
        assert not any(path.exists() for path in left)
    wait_ended(rig)


def test_files_of_killed_rigs_are_swept_after_their_starters_end():
    """Their names are never used twice, so that nobody else would."""
    code = """
import os, signal
from lerobot_robot_yam.rig.client.rig_control import RigControl
rig = RigControl.start()
print(rig.name, rig.pid, flush=True)
os.kill(rig.pid, signal.SIGKILL)
os.kill(os.getpid(), signal.SIGKILL)
"""
    dead = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    name, pid = dead.stdout.split()
    wait_dead(int(pid))
    assert files_of(name)
    with RigControl.start() as rig:
        assert not files_of(name)
    wait_ended(rig)


def test_files_of_a_rig_that_runs_are_left_alone_though_its_starter_has_ended():
    code = """
from lerobot_robot_yam.rig.client.rig_control import RigControl
rig = RigControl.start()
print(rig.name, flush=True)
input()
"""
    starter = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    name = starter.stdout.readline().strip()
    with RigControl(name) as rig:
        starter.communicate()
        launch._sweep()
        assert rig.stats()["clients"] and "sock" in {file.rpartition(".")[2] for file in files_of(name)}
    wait_ended(rig)


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_one(monkeypatch):
    monkeypatch.setattr(rig_control, "_TIMEOUT_S", 0.3)
    with RigControl.start() as rig:
        with RigControl(rig.name) as slow:
            os.kill(rig.pid, signal.SIGSTOP)
            try:
                with pytest.raises(RigError, match="does not answer"):
                    slow.stats()
            finally:
                os.kill(rig.pid, signal.SIGCONT)
            time.sleep(0.2)
            with pytest.raises(RigError):
                slow.state()
    wait_ended(rig)


def test_an_owner_that_is_gone_ends_it_although_others_stay(monkeypatch):
    """In this process, as the time given to landing arms is long."""
    monkeypatch.setattr(lifetime, "ORPHAN_S", 5.0)
    owner = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    life = lifetime.Lifetime("test-orphan", owner.pid, now_s=0.0)
    life.met_a_client()
    assert not life.is_over(held=True, now_s=100.0, somebody_waits=lambda: False)
    owner.communicate()
    assert not life.is_over(held=True, now_s=101.0, somebody_waits=lambda: False)
    assert life.is_over(held=True, now_s=106.1, somebody_waits=lambda: True)
    life.close()


def test_a_connection_that_waits_or_a_starter_keeps_it():
    life = lifetime.Lifetime("test-waits", None, now_s=0.0)
    assert not life.is_over(held=False, now_s=9.0, somebody_waits=lambda: False)  # the first client may need long
    assert not life.is_over(held=False, now_s=11.0, somebody_waits=lambda: True)
    with FileLock(launch.rig_path("test-waits", "lock"), "the test"):
        assert not life.is_over(held=False, now_s=12.0, somebody_waits=lambda: False)
    assert life.is_over(held=False, now_s=13.0, somebody_waits=lambda: False)
    life.close()
    assert files_of("test-waits") == []


def test_a_name_that_is_no_pid_is_refused():
    with pytest.raises(ConfigError, match="process id"):
        rig_name("auto:me")


def test_options_for_a_running_rig_are_logged_once(rig, caplog):
    for options in ({"operator": "pick_and_place", "seed": 0}, {"operator": "pick_and_place"}):
        with can.Bus(interface="yam_sim", channel="leader_left", rig=rig.name, **options):
            pass
    said = [record.message for record in caplog.records if "no effect" in record.message]
    assert said == [f"rig {rig.name} runs already, with operator: 'none'; 'pick_and_place' has no effect"]


def test_a_scene_for_a_running_rig_is_logged(rig, caplog):
    for scene in ("bimanual_table", "drawer"):
        RigControl(rig.name, scene).close()
    said = [record.message for record in caplog.records if "no effect" in record.message]
    assert said == [f"rig {rig.name} runs already, with scene: 'bimanual_table'; 'drawer' has no effect"]
