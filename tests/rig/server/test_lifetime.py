"""A rig ends with its last client, however that ends, and leaves nothing."""

import os
import signal
import subprocess
import sys
import time

import can
import pytest

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig import control
from lerobot_robot_yam.rig.client import launch
from lerobot_robot_yam.rig.control import RigControl, running_rig, runs, wait_ended
from lerobot_robot_yam.rig.server import lifetime
from lerobot_robot_yam.system.runtime_files import FileLock, rig_name, runtime_dir
from tests.support.waiting import wait

CLIENT = """
import can, os, sys, time
bus = can.Bus(interface="yam_sim", channel="leader_left", rig={rig!r})
from lerobot_robot_yam.rig.control import RigControl
print(RigControl(bus.rig, hold=False).pid, bus.rig, flush=True)
time.sleep(60)
"""
STARTER = """
import os, signal
from lerobot_robot_yam.rig.control import RigControl
rig = RigControl.start()
print(rig.name, rig.pid, flush=True)
{then}
"""


def files_of(name):
    return sorted(path.name for path in runtime_dir().glob(f"rig-{name}.*"))


def start_clients(rig, count):
    """Clients that start at once, as (process, pid of its rig, name of its rig)."""
    command = [sys.executable, "-c", CLIENT.format(rig=rig)]
    clients = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(count)]
    rows = [(client, *client.stdout.readline().split()) for client in clients]
    return [(client, int(pid), name) for client, pid, name in rows]


def kill(client):
    client.kill()
    client.wait()
    client.stdout.close()


def test_it_ends_after_its_last_client_and_leaves_no_file():
    rig = RigControl.start()
    bus = can.Bus(interface="yam_sim", channel="leader_left", rig=rig.name)
    assert {path.rpartition(".")[2] for path in files_of(rig.name)} == {"sock", "world", "links", "scene", "log"}
    watcher = RigControl(rig.name, hold=False)
    rig.close()
    time.sleep(1.5)
    bus.send(can.Message(arbitration_id=0x7FF, data=(1, 0, 0xCC, 0, 0, 0, 0, 0), is_extended_id=False))
    assert bus.recv(5.0) is not None  # still there for the bus
    bus.shutdown()
    with RigControl(rig.name) as again:  # a quick return finds the same rig
        assert again.pid == rig.pid
    wait_ended(rig)  # a watcher does not keep it
    with pytest.raises(RigError, match="ended"):
        watcher.state()
    watcher.close()
    assert files_of(rig.name) == []


def test_a_rig_of_a_killed_process_ends_with_it():
    ((client, pid, name),) = start_clients("auto", 1)
    assert runs(pid)
    kill(client)
    wait(lambda: not runs(pid), 15.0)
    assert files_of(name) == []


@pytest.mark.long
def test_clients_that_start_at_once_share_one_rig_and_killed_ones_end_it():
    clients = start_clients("test-race", 3)
    (pid,) = {pid for _, pid, _ in clients}
    for client, _, _ in clients:
        kill(client)
    wait(lambda: not runs(pid), 15.0)
    assert files_of("test-race") == []


def test_a_killed_rig_is_replaced_and_sigterm_ends_it_cleanly():
    rig = RigControl.start(name="test-replaced")
    os.kill(rig.pid, signal.SIGKILL)
    wait_ended(rig)
    rig.close()
    with RigControl("test-replaced") as again:
        assert again.pid != rig.pid
        assert again.state()["sim_s"] >= 0
        os.kill(again.pid, signal.SIGTERM)
        wait_ended(again)
    assert files_of("test-replaced") == []


def test_a_stopped_rig_is_reported_and_an_answer_that_comes_too_late_is_not_taken_for_the_next_one(monkeypatch):
    monkeypatch.setattr(control, "_TIMEOUT_S", 0.3)
    monkeypatch.setattr(launch, "_HELLO_TIMEOUT_S", 0.3)
    with running_rig() as rig:
        with RigControl(rig.name) as slow:
            os.kill(rig.pid, signal.SIGSTOP)
            try:
                with pytest.raises(RigError, match="does not answer"):
                    slow.stats()
                with pytest.raises(RigError, match="does not answer"):
                    RigControl(rig.name)
            finally:
                os.kill(rig.pid, signal.SIGCONT)
            time.sleep(0.2)
            with pytest.raises(RigError):
                slow.state()


def test_files_of_killed_rigs_are_swept_after_their_starters_end():
    """Their names are never used twice, so that nobody else would."""
    end = "os.kill(rig.pid, signal.SIGKILL); os.kill(os.getpid(), signal.SIGKILL)"
    dead = subprocess.run([sys.executable, "-c", STARTER.format(then=end)], capture_output=True, text=True, timeout=60)
    name, pid = dead.stdout.split()
    wait(lambda: not runs(int(pid)), 15.0)
    starter = name.split("-")[1]
    left = [runtime_dir() / f"rig-auto-{starter}.{suffix}" for suffix in ("sock", "world", "log")]
    for path in left:
        path.touch()
    assert files_of(name)
    with running_rig():
        assert not files_of(name) and not any(path.exists() for path in left)


@pytest.mark.long
def test_files_of_a_rig_that_runs_are_left_alone_though_its_starter_has_ended():
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    starter = subprocess.Popen([sys.executable, "-c", STARTER.format(then="input()")], text=True, **pipes)
    name, _ = starter.stdout.readline().split()
    with RigControl(name) as rig:
        starter.communicate()
        launch._sweep()
        assert rig.stats()["clients"] and "sock" in {file.rpartition(".")[2] for file in files_of(name)}
        rig.end()
        wait_ended(rig)


def test_an_owner_that_is_gone_ends_it_although_others_stay(monkeypatch):
    """In this process, as the time given to landing arms is long."""
    monkeypatch.setattr(lifetime, "ORPHAN_S", 5.0)
    owner = subprocess.Popen(["cat"], stdin=subprocess.PIPE)
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


def test_a_scene_and_options_for_a_running_rig_are_logged_once(rig, caplog):
    for options in ({"operator": "pick_and_place", "seed": 0}, {"operator": "pick_and_place"}):
        with can.Bus(interface="yam_sim", channel="leader_left", rig=rig.name, **options):
            pass
    for scene in ("bimanual_table", "drawer"):
        RigControl(rig.name, scene).close()
    said = [record.message for record in caplog.records if "no effect" in record.message]
    assert said == [
        f"rig {rig.name} runs already, with operator: 'none'; 'pick_and_place' has no effect",
        f"rig {rig.name} runs already, with scene: 'bimanual_table'; 'drawer' has no effect",
    ]
