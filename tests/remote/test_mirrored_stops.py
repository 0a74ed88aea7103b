"""The stop of a workstation, which its programs tell by a link each."""

import time

import pytest

from lerobot_robot_yam.remote.hosted_group import Phase
from lerobot_robot_yam.remote.link_messages import Beat
from lerobot_robot_yam.remote.link_sockets import ClientSockets
from lerobot_robot_yam.remote.mirrored_stops import RELAYED, MirroredStops
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.hosted import ServedArms

ROBOT, TELEOP = b"robot", b"teleop"
HERE, STATION, OTHER = "0a", "5f", "6e"


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


@pytest.mark.parametrize("late_s", [0.01, 0.3])
def test_a_link_that_says_late_that_nothing_is_stopped_releases_nothing(stop, late_s):
    """It may have been on its way for as long as the network likes: links overtake each other."""
    stops = MirroredStops("workstation", HERE)
    for link in (ROBOT, TELEOP):
        stops.hear(STATION, link, False, 10.0)
    stops.hear(STATION, ROBOT, True, 10.1)
    assert stop.latched and stops.others == [STATION] and not stops.own
    stops.hear(STATION, TELEOP, False, 10.1 + late_s)
    assert stop.latched
    stops.hear(STATION, TELEOP, True, 10.5)
    stops.hear(STATION, ROBOT, False, 11.0)
    assert stop.latched
    stops.hear(STATION, TELEOP, False, 11.02)
    assert not stop.latched and not stops.others and not stops.own


def test_a_link_that_has_gone_says_nothing_any_more(stop):
    stops = MirroredStops("workstation", HERE)
    stops.hear(STATION, ROBOT, True, 10.0)
    stops.hear(STATION, TELEOP, False, 11.9)
    assert stop.latched
    stops.hear(STATION, TELEOP, False, 12.1)
    assert not stop.latched


def test_a_stop_is_latched_again_while_its_machine_is_there(stop):
    stops = MirroredStops("workstation", HERE)
    stops.hear(STATION, ROBOT, True, 10.0)
    stop.release()
    stops.look(11.0)
    assert stop.latched
    stop.release()
    stops.look(12.5)
    assert not stop.latched


def test_two_machines_stop_and_one_lets_go(stop):
    stops = MirroredStops("workstation", HERE)
    stops.hear(STATION, ROBOT, True, 10.0)
    stops.hear(OTHER, TELEOP, True, 10.1)
    stops.hear(STATION, ROBOT, False, 10.2)
    assert stop.latched and stops.others == [OTHER] and not stops.own
    stops.hear(OTHER, TELEOP, False, 10.3)
    assert not stop.latched


def test_a_stop_of_this_computer_is_not_released_by_another(stop):
    stops = MirroredStops("workstation", HERE)
    stop.latch("somebody here")
    stops.hear(STATION, ROBOT, True, 10.0)
    stops.hear(STATION, ROBOT, False, 10.1)
    assert stop.latched and stops.own


def test_stops_add_up(stop):
    """A workstation that releases its stop moves no arm that somebody here has stopped, too."""
    stops = MirroredStops("workstation", HERE)
    stops.hear(STATION, ROBOT, True, 10.0)
    assert not stops.own
    for why, *source in (("somebody here",), ("a button of the handle", "leader_left")):
        stop.latch(why, *source)
    stops.look(10.1)
    assert stops.own and stops.others == [STATION]  # the workstation has to know of it
    stops.hear(STATION, ROBOT, False, 10.2)
    assert stop.names() == ["leader_left", "yam-estop"] and not stops.others
    stop.release("yam-estop")
    assert stop.latched
    stop.release("leader_left")
    assert not stop.latched


def test_a_stop_ends_at_all_computers_when_it_is_released_where_it_was_latched(tmp_path, monkeypatch):
    """Two hosts, and two workstations with a link to each: what one hears it may tell another one, but not for ever."""
    stops, latches, links = {}, {}, [(host, station) for host in ("h1", "h2") for station in ("a1", "a2")]
    for name in ("h1", "h2", "a1", "a2"):
        (tmp_path / name).mkdir(mode=0o700)

    def at(name):
        monkeypatch.setenv("YAM_RUNTIME_DIR", str(tmp_path / name))

    def talk(rounds):
        for now in range(rounds):
            for host, station in links:
                at(station)
                link = stops[station, host]
                link.look(now * 0.1)
                at(host)
                stops[host].hear(station, station.encode(), link.own, now * 0.1)
                stops[host].look(now * 0.1)
                told = stops[host].own, any(other != station for other in stops[host].others)
                at(station)
                for name, stopped in zip((host, host + RELAYED), told, strict=True):
                    link.hear(name, b"", stopped, now * 0.1)
        return [name for name in latches if latches[name].latched]

    for name in ("h1", "h2", "a1", "a2"):
        at(name)
        latches[name] = EmergencyStop()
        if name.startswith("h"):
            stops[name] = MirroredStops("workstation", name)
        else:
            stops |= {(name, host): MirroredStops("host", name) for host in ("h1", "h2")}
    for name, stop in latches.items():
        stop.latch("somebody")
        assert talk(4) == list(latches), name
        stop.release("yam-estop")
        assert talk(6) == [], name


def test_a_program_of_this_computer_has_the_same_latch(stop):
    stops = MirroredStops("workstation", HERE)
    stops.hear(HERE, ROBOT, True, 10.0)
    assert not stop.latched


def test_a_stop_that_cannot_be_latched_is_told_once_and_tried_again(stop, caplog):
    in_the_way = runtime_dir() / "emergency-stop"
    in_the_way.symlink_to("/nowhere")
    stops = MirroredStops("workstation", HERE)
    try:
        stops.hear(STATION, ROBOT, True, 10.0)
        assert stops.unwritten and stops.others == [STATION] and not stop.latched
        stops.look(20.0)  # its workstation has gone meanwhile
        assert stops.unwritten
    finally:
        in_the_way.unlink()
    (told,) = [record.getMessage() for record in caplog.records]
    assert told.startswith("workstation 5f: its emergency stop cannot be latched here") and str(runtime_dir()) in told
    stops.look(20.1)
    assert stop.latched and not stops.unwritten
    assert stop.reason().startswith("workstation 5f: its emergency stop is latched")


@pytest.mark.long
def test_arms_land_while_a_stop_cannot_be_latched(stop):
    in_the_way = runtime_dir() / "emergency-stop"
    with running_rig(arms=["follower_left"]) as rig, ServedArms(rig, "follower_left") as served:
        (group,) = served.groups
        sockets = ClientSockets(served.address, None, states=False)

        def beat_until(condition, stopped):
            deadline = time.monotonic() + 20.0
            while not condition():
                assert time.monotonic() < deadline
                sockets.send(Beat(7, STATION, time.monotonic(), stopped))
                sockets.wait(0.05)
                sockets.receive()

        group.start(7, "a test", True)
        beat_until(lambda: group.phase is Phase.RUNNING, stopped=False)
        in_the_way.symlink_to("/nowhere")
        try:
            beat_until(lambda: group.phase is Phase.FREE, stopped=True)
            assert not any(motor["enabled"] for motor in rig.state()["arms"]["follower_left"]["motors"].values())
        finally:
            in_the_way.unlink()
        beat_until(lambda: stop.latched, stopped=True)
        beat_until(lambda: not stop.latched, stopped=False)
        sockets.close()
